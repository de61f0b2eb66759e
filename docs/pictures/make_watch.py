"""Draw the README's picture: `python docs/pictures/make_watch.py FILE.mcap`.

`athrl evaluate --record FOLDER` makes such a file. Needs no screen, but a Vulkan driver: Debian's
mesa-vulkan-drivers is one.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import socket
import subprocess
import sys
import time
from pathlib import Path

import rerun_cli  # type: ignore[import-untyped]
from athrl_evaluator.watching.viewer import free_port, proxy_address
from PIL import Image
from rerun.experimental import ViewerClient

PICTURE = Path(__file__).with_name("watch.png")
TIMELINE = "simulated time"
PATIENCE = 60.0
LONGEST_SIDE = 1500
COLOURS = 128  # which makes the file a quarter as large


def await_server(port: int) -> None:
    """Wait until somebody listens at the port."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
            return
        time.sleep(0.2)
    sys.exit(f"the episode was not served within {PATIENCE:g} s")


def await_episode(viewer: ViewerClient) -> None:
    """Wait until the viewer has the whole episode: its last moment no longer changes."""
    deadline, seen = time.monotonic() + PATIENCE, -1
    while time.monotonic() < deadline:
        time.sleep(3.0)
        end = last_moment(viewer)
        if 0 <= end == seen:
            return
        seen = end
    sys.exit(f"the viewer had no complete episode within {PATIENCE:g} s")


def last_moment(viewer: ViewerClient) -> int:
    """Return the simulated nanoseconds that the viewer knows of, -1 before any."""
    timelines = [line for recording in viewer.get_state().recordings for line in recording.timelines]
    return max((line.end for line in timelines if line.name == TIMELINE), default=-1)


def take(viewer: ViewerClient, seconds: float | None, path: Path) -> None:
    """Write the picture of a moment."""
    if seconds is not None:
        viewer.set_time(TIMELINE, duration=seconds, play_state="paused")
    time.sleep(3.0)  # the views follow
    picture = Image.open(io.BytesIO(viewer.take_screenshot(max_size=LONGEST_SIDE)))
    picture.convert("RGB").quantize(COLOURS).save(path, optimize=True)


def main() -> None:
    """Take the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument(
        "--seconds", type=float, help="simulated time to be shown; the last moment without it"
    )
    parser.add_argument("--to", type=Path, default=PICTURE)
    arguments = parser.parse_args()
    port = free_port()
    command = [sys.executable, "-m", "athrl", "watch", str(arguments.recording), "--serve", str(port)]
    with subprocess.Popen(command) as server:
        try:
            await_server(port)
            viewer = ViewerClient.spawn(
                headless=True,
                port=free_port(),
                hide_welcome_screen=True,
                executable_path=str(Path(rerun_cli.__file__).with_name("rerun")),
            )
            viewer.open(proxy_address("127.0.0.1", port))
            await_episode(viewer)
            take(viewer, arguments.seconds, arguments.to)
            viewer.quit()
        finally:
            server.terminate()


if __name__ == "__main__":
    main()
