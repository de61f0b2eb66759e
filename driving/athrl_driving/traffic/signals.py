"""Traffic lights, compiled. Where a map has none, every movement is as if its light were always green."""

from athrl_driving.compilation import inlined
from athrl_driving.traffic.columns import Traffic

GREEN, YELLOW, RED = 0, 1, 2


@inlined
def light(traffic: Traffic, movement: int) -> int:
    """Return the light that a movement has now: `GREEN`, also where there is none, `YELLOW` or `RED`."""
    group = traffic.rails.signal[movement]
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
