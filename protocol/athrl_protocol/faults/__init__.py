"""Failures in the background and refused messages: counted, logged once, and raised to callers."""
