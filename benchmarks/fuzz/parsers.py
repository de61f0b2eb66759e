"""The parsers of everything that comes from elsewhere, by name."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from benchmarks.fuzz.frame import Parser

PARSERS = {
    "messages": "benchmarks.fuzz.messages:parser",
    "run-file": "benchmarks.fuzz.run_files:run_file",
    "override": "benchmarks.fuzz.run_files:override",
    "served-run-file": "benchmarks.fuzz.run_files:served_run_file",
    "study": "benchmarks.fuzz.studies:study",
    "manifest": "benchmarks.fuzz.checkpoints:manifest",
    "state": "benchmarks.fuzz.checkpoints:state",
    "agent": "benchmarks.fuzz.checkpoints:agent",
    "segment": "benchmarks.fuzz.segments:segment",
    "policy-facts": "benchmarks.fuzz.run_folder:policy_facts",
    "scores": "benchmarks.fuzz.run_folder:scores",
    "changes": "benchmarks.fuzz.run_folder:changes",
    "comparison": "benchmarks.fuzz.run_folder:comparison",
    "certificate": "benchmarks.fuzz.certificates:certificate",
    "key": "benchmarks.fuzz.certificates:key",
    "authority-key": "benchmarks.fuzz.certificates:authority_key",
    "bound-actors": "benchmarks.fuzz.certificates:actors",
    "policy": "benchmarks.fuzz.policies:policy",
    "recording": "benchmarks.fuzz.recordings:recording",
    "opendrive": "benchmarks.fuzz.maps:opendrive",
}
"""Module and function of each; only the one that is used is loaded."""


def load(name: str, folder: Path) -> Parser:
    """Return a parser by its name; it may write its files into `folder`."""
    module, _, function = PARSERS[name].partition(":")
    parser = getattr(import_module(module), function)(folder)
    assert isinstance(parser, Parser)
    return parser
