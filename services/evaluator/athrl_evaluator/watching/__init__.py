"""Live episodes in a rerun viewer."""
