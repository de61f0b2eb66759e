"""What can go wrong at the learner, in lines that tell the user what to do."""


class LearnerError(Exception):
    """Base of the learner's errors; `str(error)` is one line that says what to do."""


class RunFolderTaken(LearnerError):  # noqa: N818 - the names say what happened, as in the protocol
    """A new run was to be written where another run already is."""


class RunFolderInUse(LearnerError):  # noqa: N818
    """Another learner writes this run's folder at this moment."""


class NoSuchDevice(LearnerError):  # noqa: N818
    """Training was to happen on a device that this machine has not."""


class WrongPlanner(LearnerError):  # noqa: N818
    """There is no planner like the one that the run file describes."""


class TooLittleMemory(LearnerError):  # noqa: N818
    """The replay is to be larger than what this machine gives."""


class CannotResume(LearnerError):  # noqa: N818
    """The folder holds nothing that a run could go on from."""


class SettingsDoNotFit(CannotResume):
    """Checkpoint or log were made with other settings.

    Attributes:
        what: does not fit.
    """

    def __init__(self, what: str, reason: str) -> None:
        super().__init__(f"{what} does not fit the run's settings; {reason}")
        self.what = what


class CheckpointFailed(LearnerError):  # noqa: N818
    """A checkpoint could not be written."""


class DamagedCheckpoint(LearnerError):  # noqa: N818
    """A checkpoint is not what its manifest says; the message names the file."""


class DiskFull(LearnerError):  # noqa: N818
    """There is no room to write down what would be acknowledged; it is tried again."""


class LogFailed(LearnerError):  # noqa: N818
    """The log of experience cannot be written, so nothing may be acknowledged any more."""


class Diverged(LearnerError):  # noqa: N818
    """Training met a number that is not finite; the last checkpoint is from before that."""


class Deadlock(LearnerError):  # noqa: N818
    """Actors and learner wait for each other, which the limiter rules out."""
