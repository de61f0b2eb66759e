"""Drive on maps that nobody drew: each drives well, or is refused in one line."""
