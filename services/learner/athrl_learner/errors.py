"""The learner's errors, in lines that tell the user what to do."""


class LearnerError(Exception):
    """Base of the learner's errors; `str(error)` is one line that says what to do."""


class RunFolderTaken(LearnerError):  # noqa: N818 - the names say what happened, as in the protocol
    """The folder for a new run already holds another run."""


class RunFolderInUse(LearnerError):  # noqa: N818
    """Another learner is writing this run's folder."""


class NoSuchDevice(LearnerError):  # noqa: N818
    """Training was to run on a device that this machine does not have."""


class WrongPlanner(LearnerError):  # noqa: N818
    """No planner matches the description in the run file."""


class TooLittleMemory(LearnerError):  # noqa: N818
    """The replay needs more memory than this machine has."""


class CannotResume(LearnerError):  # noqa: N818
    """The folder holds nothing that a run could be resumed from."""


class SettingsDoNotFit(CannotResume):
    """A checkpoint or log was made with other settings.

    Attributes:
        what: the checkpoint or the log.
    """

    def __init__(self, what: str, reason: str) -> None:
        super().__init__(f"{what} does not fit the run's settings; {reason}")
        self.what = what


class CheckpointFailed(LearnerError):  # noqa: N818
    """A checkpoint could not be written."""


class DamagedCheckpoint(LearnerError):  # noqa: N818
    """A checkpoint differs from its manifest; the message names the file."""


class SegmentsMissing(DamagedCheckpoint):
    """The log has none of the segments that hold a checkpoint's replay."""


class DiskFull(LearnerError):  # noqa: N818
    """The disk has no space for a chunk to be acknowledged; it will be tried again."""


class LogFailed(LearnerError):  # noqa: N818
    """The log of experience cannot be written, so no chunk may be acknowledged any more."""


class Diverged(LearnerError):  # noqa: N818
    """A number in training is not finite; the last checkpoint was written before that."""


class Deadlock(LearnerError):  # noqa: N818
    """Actors and learner wait for each other, which the limiter should prevent."""
