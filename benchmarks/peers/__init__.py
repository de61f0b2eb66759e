"""Our default run compared with other libraries: see `python -m benchmarks.peers --help`."""
