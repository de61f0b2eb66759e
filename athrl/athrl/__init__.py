"""The command: train, evaluate, watch, and show the state of a run."""
