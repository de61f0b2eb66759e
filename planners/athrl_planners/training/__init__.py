"""Training of planners: the agent, its levels, losses and batches."""
