"""Makes a run's certificates in a cluster and keeps them as secrets: what the job `certificates` runs.

    python keep_secrets.py --folder /made --names learner,router

Reads the secrets certificate-ROLE into the folder, has `athrl certificates --if-missing` make what is missing
or ends soon, and writes what is new into the secrets. The secrets exist beforehand, so the job may read and
change them and nothing else.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import ssl
import subprocess
import sys
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

ROLES = ("authority", "learner", "actor", "evaluator", "viewer", "router")
ACCOUNT = Path(os.environ.get("SERVICE_ACCOUNT", "/var/run/secrets/kubernetes.io/serviceaccount"))
"""Folder in which a cluster tells a pod its namespace, its token and the authority of its API."""
SECONDS = 30.0


class Secrets:
    """Secrets of this pod's namespace, at the cluster's API."""

    def __init__(self) -> None:
        host, port = os.environ["KUBERNETES_SERVICE_HOST"], os.environ["KUBERNETES_SERVICE_PORT"]
        namespace = (ACCOUNT / "namespace").read_text().strip()
        self._address = (
            f"https://{f'[{host}]' if ':' in host else host}:{port}/api/v1/namespaces/{namespace}/secrets"
        )
        self._token = (ACCOUNT / "token").read_text().strip()
        self._trust = ssl.create_default_context(cafile=str(ACCOUNT / "ca.crt"))

    def read(self, name: str) -> dict[str, bytes]:
        """The files in a secret."""
        data = self._ask("GET", name).get("data") or {}
        return {file: base64.b64decode(content) for file, content in data.items()}

    def write(self, name: str, files: dict[str, bytes]) -> None:
        """Put files into a secret that exists."""
        data = {file: base64.b64encode(content).decode() for file, content in files.items()}
        self._ask("PATCH", name, {"data": data})

    def _ask(self, method: str, name: str, change: dict[str, Any] | None = None) -> dict[str, Any]:
        headers = {"Authorization": f"Bearer {self._token}", "Content-Type": "application/merge-patch+json"}
        body = None if change is None else json.dumps(change).encode()
        request = Request(f"{self._address}/{name}", body, headers, method=method)
        try:
            with urlopen(request, timeout=SECONDS, context=self._trust) as answer:
                return json.load(answer)
        except HTTPError as error:
            sys.exit(f"keep_secrets.py: the secret {name}: {method} was refused, {error.code} {error.reason}")
        except (OSError, HTTPException, ValueError) as error:  # also while the answer arrives, or by no JSON
            why = getattr(error, "reason", error)
            sys.exit(f"keep_secrets.py: the cluster's API does not answer at {self._address}: {why}")


def main() -> None:
    """Bring secrets and certificates to the same state."""
    parser = argparse.ArgumentParser(description="Make a run's certificates and keep them as secrets.")
    parser.add_argument("--folder", type=Path, required=True, help="where the certificates are made")
    parser.add_argument("--names", required=True, help="names by which learner and router are reached")
    given = parser.parse_args()
    secrets = Secrets()
    kept = {role: secrets.read(f"certificate-{role}") for role in ROLES}
    for role, files in kept.items():
        _write(given.folder / role, files)
    make = ["athrl", "certificates", str(given.folder), "--if-missing", "--names", given.names]
    if code := subprocess.run(make).returncode:
        sys.exit(code)
    for role, files in kept.items():  # the authority first: what it has signed is of no use without it
        made = {file.name: file.read_bytes() for file in (given.folder / role).iterdir()}
        if made != files:
            secrets.write(f"certificate-{role}", made)
            print(f"the secret certificate-{role} has a new certificate")


def _write(folder: Path, files: dict[str, bytes]) -> None:
    """Write the files for this user alone; without files there is no folder either."""
    for name, content in files.items():
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        (folder / name).touch(mode=0o600)
        (folder / name).write_bytes(content)


if __name__ == "__main__":
    main()
