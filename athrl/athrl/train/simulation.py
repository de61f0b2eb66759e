"""Whether the first start on a machine will take longer, because the simulation has to be compiled."""

from pathlib import Path


def is_compiled() -> bool:
    """Return whether machine code of the simulation as it is now is kept."""
    from athrl_driving.compilation import cache_folder

    return any(Path(cache_folder()).rglob("*.nbi"))
