"""How services find a learner whose machine is known only once it runs: by its run's folder."""
