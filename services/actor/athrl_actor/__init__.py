"""Drives environments with the newest policy and streams what happens."""
