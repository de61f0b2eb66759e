"""Removes from an image's packages what its service never loads; `slim.py SERVICE`, see UNUSED_PACKAGES.

Packages that others name as requirements and that the service does not import; tests, examples and build
files inside packages; symbols for debuggers. For a learner without a GPU also the libraries of CUDA that
torch does not load when it computes on processors; torch's own library for GPUs is loaded in any case, and so
are those that it is linked to. The containers' tests train and drive with what is left.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path

PLOTTING = ("contourpy", "fonttools", "kiwisolver", "matplotlib", "pandas", "pyparsing", "python-dateutil")
"""highway-env plots its own environments' tables with them; `athrl_driving.deferred` does without."""

UNUSED_PACKAGES = {
    "actor": (*PLOTTING, "pillow", "six", "tzdata"),
    "evaluator": (*PLOTTING, "tzdata", "tensorboard-data-server"),  # TensorBoard reads the files itself
    "learner-cpu": ("triton",),
    "learner-gpu": (),
}

UNUSED_PATHS = (
    "*/tests",
    "*/*/tests",
    "*/*/*/tests",
    "numpy/distutils",
    "onnxruntime/capi/libonnxruntime.so.*",  # for programs in C
    "onnxruntime/quantization",
    "onnxruntime/tools",
    "onnxruntime/transformers",
    "PIL/_avif*",
    "pillow.libs/libavif*",
    "pyarrow/*flight*",
    "pyarrow/*s3*",
    "pyarrow/include",
    "pyarrow/libarrow_python.so",
    "pyarrow/libarrow_python.so.*.*",
    "pygame/docs",
    "pygame/examples",
    "torch/include",
    "torch/bin/protoc*",
    "torch/bin/test_*",
    "torch/share",
)

UNUSED_ON_PROCESSORS = (
    "nvidia/cudnn/lib/libcudnn_*",
    "nvidia/nvshmem/lib/*device*",
    "nvidia/nvshmem/lib/*.a",
    "nvidia/nvshmem/lib/*transport*",
    "nvidia/nvshmem/lib/*bootstrap*",
    "nvidia/cu13/lib/*.a",
    "nvidia/cu13/lib/libcufftw*",
    "nvidia/cu13/lib/libcusolverMg*",
    "nvidia/cu13/lib/libnvblas*",
    "nvidia/cu13/lib/libnvrtc*.alt.*",
    "nvidia/*/include",
)

PYTHON = Path("/opt/athrl/bin/python")
"""Interpreter of the image."""


def slim(site: Path, service: str) -> None:
    """Remove what `service` never loads from the packages in the folder `site`."""
    _uninstall(site, UNUSED_PACKAGES[service])
    patterns = UNUSED_PATHS + (UNUSED_ON_PROCESSORS if service == "learner-cpu" else ())
    for path in _matching(site, patterns):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    _strip(site)


def _uninstall(site: Path, packages: tuple[str, ...]) -> None:
    """Uninstall those of the packages that are installed."""
    installed = {found.metadata["Name"].lower() for found in distributions(path=[str(site)])}
    unused = sorted(installed & set(packages))
    if unused:
        pip = ["/opt/builder/bin/pip", "--python", str(PYTHON)]
        subprocess.run([*pip, "uninstall", "--quiet", "--yes", *unused], check=True)


def _matching(site: Path, patterns: tuple[str, ...]) -> Iterator[Path]:
    """Paths that match a pattern, as long as they are there."""
    for pattern in patterns:
        yield from [path for path in site.glob(pattern) if path.exists() or path.is_symlink()]


def _strip(site: Path) -> None:
    """Remove the symbols for debuggers of extension modules and programs.

    Libraries in folders *.libs have been moved there by a tool whose changes strip would undo. Those of torch
    and CUDA have no such symbols.
    """
    for library in [*site.rglob("*.so"), *site.glob("rerun_cli/rerun")]:
        inside = library.relative_to(site).parts[0]
        if not inside.endswith(".libs") and inside not in ("torch", "nvidia"):
            subprocess.run(["strip", "--strip-unneeded", str(library)], check=True)


if __name__ == "__main__":
    (service,) = sys.argv[1:]
    if service not in UNUSED_PACKAGES:
        sys.exit(f"slim.py: there is no service {service!r}, it should be {', '.join(UNUSED_PACKAGES)}")
    (site,) = PYTHON.parents[1].glob("lib/python3.*/site-packages")
    slim(site, service)
