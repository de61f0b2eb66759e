"""Write the Python code of the message schemas: `python protocol/generate.py`, after every change.

Needs grpcio-tools. The result is committed, so that an installation needs no compiler.
"""

from __future__ import annotations

import sys
from pathlib import Path

PROTOCOL = Path(__file__).parent


def generate(target: Path) -> None:
    """Compile `schemas/athrl.proto` to `athrl_pb2.py` and `athrl_pb2.pyi` in the folder `target`."""
    from grpc_tools import protoc

    arguments = ["protoc", f"-I{PROTOCOL / 'schemas'}", f"--python_out={target}", f"--pyi_out={target}"]
    if protoc.main([*arguments, str(PROTOCOL / "schemas" / "athrl.proto")]) != 0:
        raise SystemExit("the schema does not compile, see above")


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else PROTOCOL / "athrl_protocol" / "messages")
