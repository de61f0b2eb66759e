"""What the learner reports: the state of the run, and metrics, to services and to Prometheus."""
