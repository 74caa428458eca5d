"""Errors of a campaign; each message is one line that names the remedy."""

from collections.abc import Sequence
from pathlib import Path

from rpod_schemas.errors import RpodError


class CampaignError(RpodError):
    """Root of the errors that this package raises."""


class ForeignFolderError(CampaignError):
    """Raised for a folder that holds something else than this campaign."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}; give another --out, or remove the folder")


class TrialFailedError(CampaignError):
    """Raised for a trial that raised an exception, in whatever process it ran."""

    def __init__(self, place: str, kind: str, message: str, *, expected: bool, trace: str = "") -> None:
        """Compose the message.

        Args:
            place: campaign, cell, trial and seed.
            kind: class of the exception.
            message: text of the exception.
            expected: whether it is an error that names its own remedy, such as a target's.
            trace: the worker's traceback.
        """
        self.kind, self.expected, self.trace = kind, expected, trace
        super().__init__(f"{place}: {kind}: {message}")


class WorkerDiedError(CampaignError):
    """Raised for a process that ended before its trial did."""

    def __init__(self, how: str, trials: Sequence[str]) -> None:
        """Compose the message.

        Args:
            how: signal or exit code, with its usual cause.
            trials: the trials that were running.
        """
        running = f" while it ran one of: {'; '.join(trials)}" if trials else ""
        super().__init__(f"a process of the trials {how}{running}")


class NoWorkersError(CampaignError):
    """Raised for a cluster without a worker that may run the trials."""

    def __init__(self, address: str, waited_s: float, refused: Sequence[str]) -> None:
        because = f"; refused: {'; '.join(refused)}" if refused else "; start workers, or use --jobs"
        super().__init__(f"{address}: no worker to run the trials after {waited_s:g} s{because}")


class NoSchedulerError(CampaignError):
    """Raised for a cluster whose scheduler does not answer."""

    def __init__(self, address: str, waited_s: float, reason: str) -> None:
        super().__init__(f"{address}: no scheduler answers after {waited_s:g} s ({reason}); is it running?")


class CampaignUnknownError(CampaignError):
    """Raised for a name that no installed campaign has."""

    def __init__(self, name: str, known: Sequence[str]) -> None:
        super().__init__(f"campaign {name!r} is unknown; known are {', '.join(known)}")
