"""The error of this package: an environment cannot be driven with what it was given."""


class DrivingError(ValueError):
    """An invalid setting, map, place or number of vehicles; the message is one line for the user."""
