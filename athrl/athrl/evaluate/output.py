"""How scores are printed."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from athrl_protocol.run_file import EnvironmentSection
from rich.table import Table

from athrl.output import console


def print_scores(policy: str, results: Sequence[dict[str, Any]], as_json: bool) -> None:
    """Print one JSON object, with several results in `case_studies` or `towns`, or a table."""
    many = "towns" if "town" in results[0] else "case_studies"
    if as_json:
        facts = results[0] if len(results) == 1 else {many: results}
        print(json.dumps({"policy": policy, **facts}))
        return
    where = f" in {results[0]['town']}" if many == "towns" and len(results) == 1 else ""
    table = Table(title=f"{policy}{where}", show_header=False)
    table.add_column(no_wrap=True)
    for _ in results:
        table.add_column(overflow="fold")  # a map's path has to stay whole
    for name in dict.fromkeys(name for result in results for name in result):
        values = [result.get(name, "") for result in results]
        table.add_row(name, *(f"{value:.4g}" if isinstance(value, float) else str(value) for value in values))
    console().print(table)


def where_by_default(environment: EnvironmentSection, own: Path | None, is_named: bool) -> str:
    """Return one line that says where was driven, unless the command line or a run file names it."""
    towns = ", ".join(environment.towns)
    if own is not None:
        where = "" if is_named else f" in {towns}"
        return f"driven{where} with the settings of the policy's run, {os.path.relpath(own)}"
    return "" if is_named else f"driven in {towns}, the default: --town names another town or a map"
