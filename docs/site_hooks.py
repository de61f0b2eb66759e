"""Pages of the site that are made of files elsewhere in the repository, and links to such files.

A link in a page is written as it works in the repository, such as `../../driving/README.md#reward`. Here it
becomes a link to the page that is made of that file (`PAGES`), or the file itself becomes part of the site.
A link to what does not exist stays as it is, and a strict build fails on it.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
DOCS = Path(__file__).resolve().parent.name

PAGES = {
    "CHANGELOG.md": "changelog.md",
    "examples/README.md": "examples.md",
    "driving/README.md": "reference/environments.md",
    **{
        f"planners/athrl_planners/{kind}/README.md": f"explanation/deviations/{kind}.md"
        for kind in ("athrl", "hddpg", "ddpg", "hdqn")
    },
}
"""Files outside of this folder that are pages of the site: path in the repository -> page."""

_SOURCES = {page: source for source, page in PAGES.items()}
_FENCED = re.compile(r"(^ *```.*?^ *```[^\n]*$)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\((?![a-z]+:|[#/])([^)#\s]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made of files elsewhere."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links to files of the repository lead to where these are on the site."""
    place = page.file.src_uri
    source = _SOURCES.get(place, f"{DOCS}/{place}")

    def on_the_site(link: re.Match[str]) -> str:
        path, anchor = link[1], link[2] or ""
        target = _page_of(posixpath.normpath(posixpath.join(posixpath.dirname(source), path)), config, files)
        if target is None:
            return link[0]
        return f"]({posixpath.relpath(target, posixpath.dirname(place) or '.')}{anchor})"

    parts = _FENCED.split(markdown)
    return "".join(part if number % 2 else _LINK.sub(on_the_site, part) for number, part in enumerate(parts))


def _page_of(path: str, config: MkDocsConfig, files: Files) -> str | None:
    """Where a file of the repository is on the site; None if there is no such file."""
    if path in PAGES:
        return PAGES[path]
    if path.startswith(f"{DOCS}/"):
        return path.removeprefix(f"{DOCS}/")
    if not (ROOT / path).is_file():
        return None
    target = f"files/{path}"
    if files.get_file_from_path(target) is None:
        files.append(File.generated(config, target, abs_src_path=str(ROOT / path)))
    return target
