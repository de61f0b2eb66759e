"""Errors between services; the text of each is one line that says what to do."""

from __future__ import annotations


class ProtocolError(Exception):
    """Base of this package's errors."""


class AddressInUse(ProtocolError):  # noqa: N818 - the names say what happened, as in the standard library
    """Another process already listens at the address."""


class LearnerNotFound(ProtocolError):  # noqa: N818
    """No learner answers at the address."""


class NotAdmitted(ProtocolError):  # noqa: N818
    """The learner and this service do not trust each other's certificates."""


class RunNotFound(ProtocolError):  # noqa: N818
    """The address serves other runs, not this one."""


class NameTaken(ProtocolError):  # noqa: N818
    """Another live service of the run has this role and name."""


class RunFileError(ProtocolError):
    """The run file, or an override of one of its keys, is wrong."""


class BackgroundFailed(ProtocolError):  # noqa: N818
    """A thread or a callback of this process raised an exception (the cause): a bug, or lack of memory."""


class InvalidMessage(ProtocolError):  # noqa: N818
    """A received message is not valid.

    Attributes:
        reason: one word for counting: schema, malformed, size, shape, value, images, checksum or incarnation.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason
