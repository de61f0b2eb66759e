"""Measurements that anyone can run again: `python -m benchmarks.NAME`. The last line is one JSON object."""
