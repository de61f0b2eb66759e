"""What drives: a reference driver, or a policy by its file or name."""

from __future__ import annotations

import difflib
from pathlib import Path

from athrl_spaces import REFERENCE_DRIVERS

from athrl.errors import CommandError, needs


def find_driver(policy: str, option: str = "--policy ") -> str | Path:
    """Return the name of a reference driver, or the file of a policy by its path or name.

    `option` is what an error begins with, where the driver is given by an option.

    Raises:
        CommandError: it is none of these; names the nearest.
    """
    if policy in REFERENCE_DRIVERS:
        return policy
    path = Path(policy)
    if path.is_file():
        return path
    with needs("evaluator"):
        from athrl_evaluator.policies.shipped import shipped_names, shipped_policy
    if policy in shipped_names():
        return shipped_policy(policy)
    wrong = "there is no such file"
    if policy and path.exists():
        wrong = "is a folder" if path.is_dir() else "is a pipe, socket or device"
    names = [*REFERENCE_DRIVERS, *shipped_names()]
    near = difflib.get_close_matches(policy, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise CommandError(f"{option}{policy}: {wrong}, and it is none of {', '.join(names)}{hint}")


def run_file_of(driver: str | Path) -> Path | None:
    """Return the run file of the run in whose folder a policy is; None for another driver."""
    path = driver.absolute().parent if isinstance(driver, Path) else Path()
    beside = path.parent / "run.toml"
    return beside if path.name == "policies" and beside.is_file() else None
