"""Errors of training."""


class TrainingDiverged(Exception):  # noqa: N818  (the name says what happened)
    """A loss is not a finite number; the text is one line for the user."""
