"""The little of a cluster's API that the job `certificates` asks: secrets that exist are read and changed."""

from __future__ import annotations

import json
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from athrl.certificates import make_all

NAMESPACE, TOKEN = "athrl", "a token"


class ClusterApi:
    """Secrets by their names, each with its files in base64; `port` is where it listens.

    With `breaks_off` it ends each connection in the middle of its answer.
    """

    breaks_off = False

    def __init__(self, folder: Path, names: list[str], host: str) -> None:
        """Writes what a pod's service account finds into `folder`/account; `host` is how pods reach this."""
        self.secrets: dict[str, dict[str, str]] = {name: {} for name in names}
        self.account = folder / "account"
        self.account.mkdir(parents=True)
        make_all(folder / "api", [host], 1)
        (self.account / "namespace").write_text(NAMESPACE)
        (self.account / "token").write_text(TOKEN)
        (self.account / "ca.crt").write_bytes((folder / "api/learner/ca.crt").read_bytes())
        self._server = ThreadingHTTPServer(("", 0), self._handler())
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / "api/learner/tls.crt", folder / "api/learner/tls.key")
        self._server.socket = context.wrap_socket(self._server.socket, server_side=True)
        self.port = int(self._server.server_address[1])

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        secrets, api = self.secrets, self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self._answer(None)

            def do_PATCH(self) -> None:
                self._answer(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))

            def _answer(self, change: dict[str, dict[str, str]] | None) -> None:
                where, _, name = self.path.rpartition("/")
                allowed = self.headers["Authorization"] == f"Bearer {TOKEN}" and name in secrets
                if where != f"/api/v1/namespaces/{NAMESPACE}/secrets" or not allowed:
                    self.send_error(403, "Forbidden")
                    return
                if change is not None:
                    assert self.headers["Content-Type"] == "application/merge-patch+json"
                    secrets[name] |= change["data"]
                body = json.dumps({"data": secrets[name]} if secrets[name] else {}).encode()
                self.send_response(200)
                self.send_header("Content-Length", str(len(body) + api.breaks_off))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None: ...

        return Handler

    @contextmanager
    def serving(self) -> Iterator[ClusterApi]:
        """Answer until the end of the block."""
        thread = threading.Thread(target=self._server.serve_forever)
        thread.start()
        try:
            yield self
        finally:
            self._server.shutdown()
            self._server.server_close()
            thread.join(30)
