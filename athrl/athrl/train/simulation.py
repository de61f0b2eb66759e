"""Checks whether the simulation must be compiled, which delays the first start on a machine."""

from pathlib import Path


def is_compiled() -> bool:
    """Return whether machine code of the current simulation is cached."""
    from athrl_driving.kernels.compilation import cache_folder
    from athrl_driving.kernels.machine_code import INDEX

    return any(Path(cache_folder()).rglob(f"*{INDEX}"))
