"""What `athrl train` shows during a run: a panel on a terminal, otherwise a plain line now and then."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from athrl.run_view import RunSnapshot
from athrl.status_panel import draw, plain_line

PLAIN_SECONDS = 10.0


class Display:
    """Shows snapshots of a run and events of its services. Use it in `with`."""

    def __init__(self) -> None:
        self._console = Console()
        self._live = Live(Text("starting"), console=self._console, auto_refresh=False, transient=False)
        self._last_line_at = -PLAIN_SECONDS

    def __enter__(self) -> Display:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def say(self, line: str) -> None:
        """Show one line that stays."""
        self._console.print(f"athrl: {line}", markup=False, highlight=False, soft_wrap=True)

    def show(self, snapshot: RunSnapshot, where_to_look: list[str]) -> None:
        """Show the current state of the run."""
        if self._console.is_terminal:
            self._live.update(draw(snapshot, where_to_look), refresh=True)
            return
        now = time.monotonic()
        if now - self._last_line_at >= PLAIN_SECONDS:
            self._last_line_at = now
            print(plain_line(snapshot), flush=True)
