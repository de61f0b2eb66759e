"""A real Chromium without a window: it opens a page, and tells what is on it and how it looks.

It is spoken to over its debugging pipe, so that no port and no library for WebSockets is needed: messages are
JSON, each ended by a zero byte. WebGL is computed on the processor.
"""

from __future__ import annotations

import base64
import json
import os
import selectors
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

OPTIONS = (
    "--headless=new",
    "--no-sandbox",  # tests may run as root
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # Nothing but this machine is reached, whatever a page asks for.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
    "--remote-debugging-pipe",
)
ANSWER_SECONDS = 120.0
END_SECONDS = 10.0


class Page:
    """One page of the browser."""

    def __init__(self, process: subprocess.Popen) -> None:
        """The browser is spoken to through `stdin` and `stdout` of its process."""
        assert process.stdin is not None
        assert process.stdout is not None
        self._process, self._requests, self._answers = process, process.stdin, process.stdout
        self._buffer = bytearray()
        self._sent = 0
        self._session: str | None = None
        self._loaded = False
        (target,) = (
            each for each in self._call("Target.getTargets")["targetInfos"] if each["type"] == "page"
        )
        attached = self._call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        self._call("Page.enable")

    def open(self, address: str) -> None:
        """Go to an address; returns when the page is loaded."""
        self._loaded = False
        answer = self._call("Page.navigate", url=address)
        assert "errorText" not in answer, f"{address}: {answer['errorText']}"
        deadline = time.monotonic() + ANSWER_SECONDS
        while not self._loaded:
            self._receive(deadline)

    def text(self) -> str:
        """The text that is on the page, also of components with a tree of their own."""
        return str(self.value(_ALL_TEXT))

    def value(self, script: str) -> Any:
        """What a line of JavaScript gives in the page."""
        answer = self._call("Runtime.evaluate", expression=script, returnByValue=True)
        return answer["result"].get("value")

    def picture(self) -> bytes:
        """The page as it looks now, a PNG."""
        return base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])

    def _call(self, method: str, **parameters: Any) -> Any:
        self._sent += 1
        message = {"id": self._sent, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        self._requests.write(json.dumps(message).encode() + b"\0")
        self._requests.flush()
        deadline = time.monotonic() + ANSWER_SECONDS
        while True:
            answer = self._receive(deadline)
            if answer.get("id") == self._sent:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    def _receive(self, deadline: float) -> Any:
        """The browser's next message."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._answers, selectors.EVENT_READ)
            while b"\0" not in self._buffer:
                assert selector.select(deadline - time.monotonic()), "the browser does not answer"
                received = os.read(self._answers.fileno(), 1 << 20)
                assert received, f"the browser has ended, exit code {self._process.poll()}"
                self._buffer += received
        message, _, rest = bytes(self._buffer).partition(b"\0")
        self._buffer = bytearray(rest)
        answer = json.loads(message)
        self._loaded |= answer.get("method") == "Page.loadEventFired"
        return answer


_ALL_TEXT = """
(function text(node) {
  let found = node.nodeType === Node.TEXT_NODE ? node.data : "";
  if (["SCRIPT", "STYLE"].includes(node.nodeName)) return "";
  for (const child of [...(node.shadowRoot ? [node.shadowRoot] : []), ...node.childNodes])
    found += " " + text(child);
  return found;
})(document.body).replace(/\\s+/g, " ")
"""


@contextmanager
def chromium(folder: Path, width: int = 1280, height: int = 800) -> Iterator[Page]:
    """A browser whose profile is in `folder`, with an empty page of this size in pixels."""
    assert PROGRAM is not None
    browser = [
        PROGRAM,
        *OPTIONS,
        f"--user-data-dir={folder}",
        f"--window-size={width},{height}",
        "about:blank",
    ]
    with subprocess.Popen(
        # The browser reads requests at 3 and writes answers to 4.
        ["sh", "-c", 'exec "$@" 3<&0 4>&1 </dev/null >/dev/null', "sh", *browser],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        try:
            yield Page(process)
        finally:
            process.terminate()
            try:
                process.wait(END_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
