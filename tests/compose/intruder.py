"""Tries to get into a run, with Zenoh alone and nothing of ours that would be polite.

    python intruder.py FOLDER ADDRESS...

FOLDER has the authority to trust and the certificate to show, as far as there are any. Prints one JSON
object: what came of it at each address, which is `admitted` or why not.
"""

import json
import sys
from pathlib import Path

import zenoh

ATTEMPT_MILLISECONDS = 3000
FILES = {
    "root_ca_certificate": "ca.crt",
    "connect_certificate": "tls.crt",
    "connect_private_key": "tls.key",
}


def configuration(address: str, folder: Path) -> zenoh.Config:
    """Return a client's, which shows what there is."""
    settings = {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "connect/endpoints": [address],
        "connect/timeout_ms": ATTEMPT_MILLISECONDS,
        "connect/exit_on_failure": True,
    }
    tls = {key: str(folder / name) for key, name in FILES.items() if (folder / name).exists()}
    if tls:
        settings["transport/link/tls"] = {"enable_mtls": "connect_certificate" in tls, **tls}
    configuration = zenoh.Config()
    for key, value in settings.items():
        configuration.insert_json5(key, json.dumps(value))
    return configuration


def attempt(address: str, folder: Path) -> str:
    """Try one address."""
    try:
        zenoh.open(configuration(address, folder)).close()
    except zenoh.ZError as error:
        return str(error)
    return "admitted"


if __name__ == "__main__":
    folder, *addresses = sys.argv[1:]
    print(json.dumps({address: attempt(address, Path(folder)) for address in addresses}))
