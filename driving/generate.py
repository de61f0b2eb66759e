"""Write the Python code of the schema of policies: `python driving/generate.py`, after every change.

Needs grpcio-tools. The result is committed, so that an installation needs no compiler.
"""

from __future__ import annotations

import sys
from pathlib import Path

DRIVING = Path(__file__).parent


def generate(target: Path) -> None:
    """Compile `schemas/onnx_model.proto` to `onnx_model_pb2.py` and `onnx_model_pb2.pyi` in `target`."""
    from grpc_tools import protoc

    arguments = ["protoc", f"-I{DRIVING / 'schemas'}", f"--python_out={target}", f"--pyi_out={target}"]
    if protoc.main([*arguments, str(DRIVING / "schemas" / "onnx_model.proto")]) != 0:
        raise SystemExit("the schema does not compile, see above")


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else DRIVING / "athrl_driving" / "policy" / "graph")
