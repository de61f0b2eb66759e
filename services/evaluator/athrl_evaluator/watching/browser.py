"""Tells people where to look, and opens the page in their browser if this machine has one."""

from __future__ import annotations

import os
import webbrowser

from athrl_evaluator.watching.viewer import PAGE_VARIABLE, has_screen


def tell(what: str, address: str) -> None:
    """Print what is seen where; a page, `http...`, is also opened in this machine's browser.

    A page that a container or a proxy publishes is not: nobody sits at that machine.
    """
    print(f"{what}: {address}", flush=True)
    if address.startswith("http") and not os.environ.get(PAGE_VARIABLE) and not _opened(address):
        print("there is no browser on this machine: open that address elsewhere, see --help", flush=True)


def _opened(address: str) -> bool:
    """Whether a browser with a window shows the page."""
    try:
        return has_screen() and webbrowser.open(address)
    except webbrowser.Error:
        return False
