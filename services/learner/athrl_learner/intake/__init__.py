"""Intake of chunks: they are validated, limited, and stored in replay and log."""
