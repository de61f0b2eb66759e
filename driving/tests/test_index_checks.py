"""The debug build of the kernels checks every index."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from athrl_driving.kernels import compilation

_KERNELS = """
import numpy as np
from athrl_driving.kernels.compilation import compiled, entry, inlined, inner, part, spliced

@part
def of_part(values, index):
    return values[index]

@spliced
def of_spliced(values, index):
    return values[index]

@inlined
def of_inlined(values, index):
    return values[index]

@inner
def of_inner(values, index):
    return values[index]

@entry
def read(values, index, how):
    if how == 0:
        return of_part(values, index)
    return of_spliced(values, index)

@compiled
def read_counted(values, index, how):
    if how == 0:
        return of_inlined(values, index)
    return of_inner(values, index)

@compiled
def write(table, row, column):
    table[row, column] = 1.0

@compiled
def total(values, first, last):
    return values[first:last].sum() + values[first:].sum()

def said(kernel, *arguments):
    try:
        kernel(*arguments)
        print("nothing")
    except IndexError as error:
        print(error)

values, table = np.zeros(5), np.zeros((2, 3))
for how in (0, 1):
    for index in (4, 5, -1, np.uint64(7)):
        said(read, values, index, how)
        said(read_counted, values, index, how)
for place in ((1, 2), (2, 0), (1, 3), (-1, 0)):
    said(write, table, *place)
for limits in ((0, 5), (5, 5), (0, 6), (-1, 5)):
    said(total, values, *limits)
"""


def test_every_kind_of_kernel_says_which_index_is_wrong_and_where(tmp_path: Path) -> None:
    script = tmp_path / "kernels.py"
    script.write_text(_KERNELS)
    environment = {**os.environ, "ATHRL_CHECK_INDICES": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    result = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=120, env=environment
    )
    assert result.returncode == 0, result.stderr
    kernels = f"{tmp_path.name}/kernels.py"
    read_lines = [7, 15, 11, 19]
    expected = []
    for first in (0, 2):
        for index in (4, 5, -1, 7):
            for line in read_lines[first : first + 2]:
                wrong = f"{kernels}:{line}: axis 0 has 5 places, it is indexed with {index}"
                expected.append("nothing" if index == 4 else wrong)
    expected += [
        "nothing",
        f"{kernels}:35: axis 0 has 2 places, it is indexed with 2",
        f"{kernels}:35: axis 1 has 3 places, it is indexed with 3",
        f"{kernels}:35: axis 0 has 2 places, it is indexed with -1",
        "nothing",
        "nothing",
        f"{kernels}:39: axis 0 has 5 places, it is indexed with 6",
        f"{kernels}:39: axis 0 has 5 places, it is indexed with -1",
    ]
    assert result.stdout.splitlines() == expected


def test_code_with_checks_has_a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    folders = set()
    for checks in (False, True):
        for of_numba in (None, 1):
            monkeypatch.setattr(compilation, "CHECKS_INDICES", checks)
            monkeypatch.setattr(compilation.numba.config, "BOUNDSCHECK", of_numba)
            folders.add(compilation.cache_folder.__wrapped__())
    assert len(folders) == 4
