"""Scores policies, records episodes and shows them."""
