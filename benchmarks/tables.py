"""Make the tables of docs/benchmarks.md from the files in benchmarks/results.

    python -m benchmarks.tables           write the pages
    python -m benchmarks.tables --check   say in one line which page is stale; exit code 1 if one is

`benchmarks.result_tables` tells the form of these files. Another page gets a subject's table between the
lines `<!-- SUBJECT -->` and `<!-- /SUBJECT -->`.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.result_tables import RESULTS, SECTIONS, Cell, ResultsError, Table, read_tables

ROOT = Path(__file__).parents[1]
PAGE = Path("docs/benchmarks.md")

_MARKER = re.compile(r"^<!-- ([a-z0-9-]+) -->\n(.*?)^<!-- /\1 -->$", re.MULTILINE | re.DOTALL)

_HEAD = """\
# Benchmarks

`python -m benchmarks.tables` makes this page from the files in `benchmarks/results`: change those, not this.

Where no machine is named, it is two cores of a shared virtual machine without a GPU, Python 3.11, with other
work beside; *load* is the load average meanwhile. What such cores do in a second changes by a factor of three
from day to day, so read the ratios. The commit is the one that wrote the figures down, also where newer code
has not been measured. The last line that each command prints is one JSON object. Why things are as fast as
they are: [performance](performance.md).
"""
_TAIL = """\
## Without a table

- `python -m benchmarks.failures POLICY.onnx` lists each collision and lane exit of a policy: where, with
  whom, and what led to it.
- `python -m benchmarks.ship_policy RUN NAME --purpose TEXT` scores a run's policy and puts it into the
  package with a card.
- `python -m benchmarks.peers` trains planners of [other libraries](peers.md) beside ours.
"""


def wanted_pages(root: Path) -> dict[Path, str]:
    """What docs/benchmarks.md, and each page with a marker, should hold, by path relative to `root`.

    Raises `ResultsError` as `read_tables` does, and for a table whose explaining page is not in docs once.
    """
    tables = read_tables(root)
    pages = {PAGE: _benchmarks_page(root, tables)}
    for path in [root / "README.md", *sorted((root / "docs").rglob("*.md"))]:
        page = path.relative_to(root)
        if page == PAGE or not path.exists():
            continue
        found = path.read_text(encoding="utf-8")
        filled = _MARKER.sub(lambda match, page=page: _section(root, page, match, tables), found)
        if filled != found or _MARKER.search(found):
            pages[page] = filled
    return pages


def stale_pages(root: Path) -> list[Path]:
    """The pages that do not hold what they should, relative to `root`; raises as `wanted_pages` does."""
    wanted = wanted_pages(root)
    return [
        page
        for page, text in wanted.items()
        if not (root / page).exists() or (root / page).read_text(encoding="utf-8") != text
    ]


def _benchmarks_page(root: Path, tables: Mapping[str, Table]) -> str:
    parts = [_HEAD]
    for section in SECTIONS:
        parts.append(f"## {section}\n")
        for table in tables.values():
            if table.section == section:
                parts.append(f"### {table.title}\n\n{_body(root, PAGE, table)}")
    parts.append(_TAIL)
    return "\n".join(parts)


def _section(root: Path, page: Path, match: re.Match[str], tables: Mapping[str, Table]) -> str:
    """A page's part between two markers, markers included; of an unknown subject it stays as it is."""
    subject = match[1]
    if subject in tables:
        body = f"\n{_body(root, page, tables[subject])}\n"
    elif subject.startswith("peers-"):
        body = "\nNot measured yet.\n\n"
    else:
        return match[0]
    return f"<!-- {subject} -->\n{body}<!-- /{subject} -->"


def _body(root: Path, page: Path, table: Table) -> str:
    """Everything of a table below its heading."""
    said = [table.question]
    if table.peer:
        said.append(f"Compared with {table.peer}.")
    if table.goal:
        said.append(f"Goal: {table.goal}.")
    if table.page and page != Path("docs") / table.page:
        link = _link(root, page, table.page, RESULTS / f"{table.subject}.json")
        said.append(f"More: [{Path(table.page).stem.replace('-', ' ')}]({link}).")
    origin = [f"`{table.command}`"] if table.command else []
    origin += [f"commit {table.commit}"] if table.commit else []
    origin += [text for text in (table.date, table.machine) if text]
    lines = [*said, "", *(["; ".join(origin) + ".", ""] if origin else [])]
    lines.append(f"| {' | '.join(table.columns)} |")
    lines.append(f"|---|{'---:|' * (len(table.columns) - 1)}")
    lines += [f"| {' | '.join(_shown(cell) for cell in row)} |" for row in table.rows]
    lines += ["", *(f"- {note}" for note in table.notes)] if table.notes else []
    return "\n".join(lines) + "\n"


def _shown(cell: Cell) -> str:
    if cell is None:
        return ""
    return cell if isinstance(cell, str) else f"{cell:,}"


def _link(root: Path, page: Path, target: str, file: Path) -> str:
    """The relative link from a page to another one, whose path in docs a file of results names."""
    if not (root / "docs" / target).is_file():
        raise ResultsError(file, "page", f"a page in docs, {target} is not there")
    return Path(os.path.relpath(root / "docs" / target, (root / page).parent)).as_posix()


def main(words: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Write the pages, or check them; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; say which page is stale")
    arguments = parser.parse_args(words)
    try:
        wanted, stale = wanted_pages(root), stale_pages(root)
    except ResultsError as error:
        print(error, file=sys.stderr)
        return 2
    if not arguments.check:
        for page in stale:
            (root / page).write_text(wanted[page], encoding="utf-8")
            print(f"wrote {page}")
        return 0
    if stale:
        print(f"stale: {', '.join(map(str, stale))}; python -m benchmarks.tables makes it", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
