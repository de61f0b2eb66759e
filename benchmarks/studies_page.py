"""Make docs/results.md from the studies' files.

    python -m benchmarks.studies_page           write the page, and the pictures of its curves
    python -m benchmarks.studies_page --check   say in one line if the page is stale; exit code 1 if it is

A study's figures are `studies/results/NAME.json`, which is the `study.json` in the folder of
`athrl study studies/NAME.toml`. A study without any is on the page with empty cells.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from athrl.errors import CommandError
from athrl.runs import declare_installed_planners
from athrl.study.curves import picture
from athrl.study.file import read_study_file
from athrl.study.folder import StudyFolder, read_object
from athrl.study.plan import planned_runs
from athrl.study.table import markdown, tabulated
from athrl_spaces.untrusted import parser_errors
from athrl_spaces.wording import counted

ROOT = Path(__file__).parents[1]
PAGE = Path("docs/results.md")
STUDIES = ("paper", "default", "generalisation", "ablations")
"""On the page, in this order."""

_HEAD = """\
# Results

`python -m benchmarks.studies_page` makes this page from the files in `studies/results`: change those, not
this.

A figure is the mean over seeds; in brackets is its 95 % interval, by a bootstrap over the seeds. *Training*
is the mean of what the actors reported after the random decisions, with exploration. *Greedy* is the last
policy on episodes of seeds on which no run trains or evaluates. *Published* figures are averages in training.
A return is points an episode, of which a metre driven gives 10.

How to repeat it: [run a study](how-to/run-a-study.md).
"""

_CASE_STUDIES = """\
## The case studies in pictures

![Five moments of an episode in the roundabout, with oncoming traffic, and of an unprotected left turn](\
pictures/case-studies.png)

The shipped policy of town03 drives the green car. The line is its route, the orange point the waypoint of its
trajectory planner. `python docs/pictures/make_case_studies.py` draws it.
"""


def page(root: Path) -> str:
    """Return what docs/results.md should hold; raises CommandError for a study's file that is damaged."""
    return "\n".join([_HEAD, *(_section(root, name) for name in STUDIES), _CASE_STUDIES])


def measured(root: Path, name: str) -> dict[str, Any] | None:
    """Return the figures of a study; None if there are none yet.

    Raises:
        CommandError: the file is not what `athrl study` writes.
    """
    path = root / "studies" / "results" / f"{name}.json"
    if not path.exists():
        return None
    with parser_errors(lambda reason: CommandError(f"{path}: {reason}")):
        found = read_object(path)
        if found["study"] != name:
            raise CommandError(f"{path}: study is {found['study']!r}, should be {name!r}")
        markdown(found)
        _origin(found)
        return found


def _section(root: Path, name: str) -> str:
    """A study's heading, origin, table and picture."""
    file = root / "studies" / f"{name}.toml"
    found = measured(root, name)
    if found is None:
        study = read_study_file(file)
        nothing = StudyFolder(root / "studies" / "results" / name)
        found = tabulated(study, planned_runs(file, study), nothing)
        kinds = f"{len(found['rows'])} combinations of planner, town and variant"
        said = f"Not measured yet: `athrl study studies/{name}.toml` does it, for {kinds}."
        if not study.published:  # nothing but empty cells
            return f"## {found['title']}\n\n{said}\n"
    else:
        said = _origin(found)
    parts = [f"## {found['title']}\n", f"{said}\n", markdown(found)]
    if (root / _picture(name)).exists():
        parts.append(
            f"![Learning curves: mean over seeds with 95 % bands]({_picture(name).relative_to('docs')})\n"
        )
    return "\n".join(parts)


def _origin(found: Mapping[str, Any]) -> str:
    """How and where a study's figures were made, and what they cost."""
    scoring = found["scoring"]
    runs = [run for run in found["runs"] if "failure" not in run]
    if not runs:
        return f"`athrl study studies/{found['study']}.toml`; no run has finished."
    made = [run["made"] for run in runs]
    hours = sum(run["seconds"] or 0.0 for run in runs) / 3600
    pieces = sum(run["seconds"] is None for run in runs)
    unknown = f", without {pieces} runs that were interrupted, whose time is not known" if pieces else ""
    dates = sorted({each["date"] for each in made})
    machines = dict.fromkeys(f"{counted(each['cores'], 'core')} of {each['processor']}" for each in made)
    return (
        f"`athrl study studies/{found['study']}.toml`; "
        f"commit {', '.join(dict.fromkeys(each['commit'] or 'unknown' for each in made))}; "
        f"{' to '.join(dict.fromkeys((dates[0], dates[-1])))}; each run on {' or '.join(machines)}; "
        f"{hours:.1f} hours of training{unknown}. "
        f"Scored on {scoring['episodes']} episodes from seed {scoring['first_seed']} on."
    )


def _picture(name: str) -> Path:
    return Path(f"docs/pictures/results-{name}.png")


def _draw(root: Path) -> None:
    """Write the pictures of the studies that have figures."""
    for name in STUDIES:
        found = measured(root, name)
        content = picture(found) if found is not None else None
        if content is not None:
            (root / _picture(name)).write_bytes(content)


def main(words: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Write the page or check it; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; say if the page is stale")
    arguments = parser.parse_args(words)
    declare_installed_planners()
    try:
        if not arguments.check:
            _draw(root)
        wanted = page(root)
    except CommandError as error:
        print(error, file=sys.stderr)
        return 2
    there = (root / PAGE).read_text(encoding="utf-8") if (root / PAGE).exists() else ""
    if there == wanted:
        return 0
    if arguments.check:
        print(f"stale: {PAGE}; python -m benchmarks.studies_page makes it", file=sys.stderr)
        return 1
    (root / PAGE).write_text(wanted, encoding="utf-8")
    print(f"wrote {PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
