"""Write `presets/default.toml` and `docs/settings.md`: `python presets/generate.py`.

To be run after every change of a setting: both follow from the run file and the settings of the planners.
"""

from __future__ import annotations

from pathlib import Path

from athrl_planners.registry import settings_tables
from athrl_protocol.run_file import declare_planners, default_toml, reference_page

ROOT = Path(__file__).parents[1]


def contents() -> dict[Path, str]:
    """Return what each of the files should hold."""
    declare_planners(settings_tables())
    return {
        ROOT / "presets" / "default.toml": default_toml(),
        ROOT / "docs" / "settings.md": reference_page(),
    }


if __name__ == "__main__":
    for path, content in contents().items():
        path.write_text(content)
