"""Throw broken input at every parser: each piece must be refused with our own error, or be proper."""
