"""Whether the first start on a machine will take longer, because the simulation has to be compiled."""

from pathlib import Path

from athrl_driving.compilation import cache_folder


def is_compiled() -> bool:
    """Return whether machine code of the simulation as it is now is kept."""
    return any(Path(cache_folder()).rglob("*.nbi"))
