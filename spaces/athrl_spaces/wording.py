"""Words that messages to people have in common."""

from __future__ import annotations


def system_reason(error: OSError) -> str:
    """Return why the system refused something: "no space left on device".

    It follows what could not be done in a message: "cannot write x: no space left on device". An error that
    a library raised without the system's words gives its own text, one without a text the name of its class.
    """
    if error.strerror:
        return error.strerror.lower()
    return str(error) or type(error).__name__


def counted(number: int, thing: str) -> str:
    """Return how many there are of a thing that has a regular plural: "1 episode", "2,000 episodes"."""
    return f"{number:,} {thing}" + ("" if number == 1 else "s")
