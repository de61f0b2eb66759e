"""Write `presets/default.toml`, `docs/settings.md` and the tables of metrics: `python presets/generate.py`.

To be run after every change of a setting or metric. The first two follow from the run file and the settings
of the planners, the tables in `docs/reference/metrics.md` from `athrl_protocol.monitoring.table`.
"""

from __future__ import annotations

from pathlib import Path

from athrl_planners.registry import settings_tables
from athrl_protocol.monitoring.reference import with_tables
from athrl_protocol.run_file import declare_planners, default_toml, reference_page

ROOT = Path(__file__).parents[1]


def contents() -> dict[Path, str]:
    """Return what each of the files should hold."""
    declare_planners(settings_tables())
    metrics = ROOT / "docs" / "reference" / "metrics.md"
    return {
        ROOT / "presets" / "default.toml": default_toml(),
        ROOT / "docs" / "settings.md": reference_page(),
        metrics: with_tables(metrics.read_text()),
    }


if __name__ == "__main__":
    for path, content in contents().items():
        path.write_text(content)
