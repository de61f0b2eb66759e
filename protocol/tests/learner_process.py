"""A learner in a separate process, to be killed: stores each chunk in a file before it acknowledges it.

Arguments: address, run, folder. The file has a line `actor incarnation sequence first-reward` for each
chunk, and after a restart the ledger is made from it.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path

from athrl_protocol import Chunk, ChunkIntake, open_session


def main(address: str, run: str, folder: str) -> None:
    path = Path(folder) / "chunks.txt"
    ledger: dict[str, dict[str, int]] = {}
    if path.exists():
        for line in path.read_text().splitlines():
            actor, incarnation, sequence, _ = line.split()
            ledger.setdefault(actor, {})[incarnation] = int(sequence) + 1
    with path.open("a") as file:

        def accept(chunk: Chunk) -> None:
            reward = chunk.levels["intention"].rewards[0]
            file.write(f"{chunk.actor} {chunk.incarnation} {chunk.sequence} {reward:g}\n")
            file.flush()

        with open_session(listen=address, timeout=5) as session, ChunkIntake(session, run, accept, ledger):
            threading.Event().wait(120)


if __name__ == "__main__":
    main(*sys.argv[1:])
