"""The command: train, evaluate, watch and see the state of a run."""
