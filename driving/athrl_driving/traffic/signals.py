"""Traffic lights, compiled. On a map without lights every movement is treated as always green."""

from athrl_driving.kernels.compilation import inlined
from athrl_driving.traffic.columns import Traffic

GREEN, YELLOW, RED = 0, 1, 2


@inlined
def light(traffic: Traffic, movement: int) -> int:
    """Return the present light of a movement: `GREEN` (also without a light), `YELLOW` or `RED`."""
    group = traffic.lane_links.signal[movement]
    if group < 0:
        return GREEN
    signals = traffic.signals
    cycle = signals.cycle[group]
    elapsed = (traffic.scratch.clock[0] - signals.green_from[group]) % cycle
    green = (signals.green_until[group] - signals.green_from[group]) % cycle
    if elapsed < green:
        return GREEN
    return YELLOW if elapsed < green + signals.yellow[group] else RED


@inlined
def red_light(traffic: Traffic, movement: int) -> bool:
    """Tell whether the light of a movement is red now; yellow is not."""
    return light(traffic, movement) == RED
