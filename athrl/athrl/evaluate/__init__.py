"""Scores of a driver, in towns or in the paper's case studies."""
