"""A complete run on one machine: services as separate processes, supervised and displayed."""
