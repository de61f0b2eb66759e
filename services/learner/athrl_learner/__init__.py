"""Takes experience in, trains, publishes policies and writes checkpoints."""
