"""What the services of a run say to each other."""
