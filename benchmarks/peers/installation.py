"""Separate environments for libraries that conflict with ours; they can also import ours."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

PACKAGES = {"torchrl": ("torchrl",), "rllib": ("ray[rllib]",)}
"""What to install, by the name that `--with` knows."""

PEER_OF = {"torchrl": "torchrl_ppo", "rllib": "rllib_ppo"}
INSTALLATION_SECONDS = 900.0


class NotInstalled(RuntimeError):  # noqa: N818  (the name says what happened)
    """A library cannot be installed here; `str()` is one line."""


def install(library: str, folder: Path) -> Path:
    """Install a library into `folder` if necessary, and return its Python.

    What it needs and we have, such as torch, is taken from our environment; where it insists on another
    version, as RLlib does on its gymnasium, that goes before ours.

    Raises:
        NotInstalled: it cannot be installed.
    """
    python = folder / "bin" / "python"
    done = folder / "installed"
    if done.exists():
        return python
    venv.create(folder, with_pip=True)
    ours = sysconfig.get_paths()["purelib"]
    path = subprocess.check_output(
        [python, "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])"], text=True
    )
    behind = Path(path.strip()) / "zz_behind.pth"  # by its name after all others
    behind.write_text(f"import site; site.addsitedir({ours!r})\n")
    command = [str(python), "-m", "pip", "install", "--quiet", *PACKAGES[library]]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=INSTALLATION_SECONDS)
    except subprocess.TimeoutExpired:
        raise NotInstalled(f"{library} was not installed within {INSTALLATION_SECONDS:.0f} s") from None
    if found.returncode != 0:
        errors = [line for line in found.stderr.splitlines() if line.startswith("ERROR")]
        why = errors[0][:200] if errors else "pip gives no reason"
        raise NotInstalled(f"{library} cannot be installed for {sys.executable}: {why}")
    done.touch()
    return python
