"""Studies: a grid of runs, or a search over settings, in one folder, with one table and curves."""
