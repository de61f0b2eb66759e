"""The error of the room: what an environment was given cannot be driven."""


class DrivingError(ValueError):
    """A setting, a map, a place or a number of vehicles that cannot be; the text is one line for the user."""
