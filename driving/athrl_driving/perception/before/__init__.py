"""The drawing of the former environment, until the present one draws with the new."""
