"""A search made an acquisition: its candidates are refined by the tracker, judged, and the best is chosen."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.ports import Acquisition, Candidates, Registration, Search, Tracker, Verdict
from rpod_pose.verification import doubt
from rpod_schemas.config.verification import VerificationConfig
from rpod_schemas.types import Hypothesis, LidarScan, PmdFrame, Source


class VerifiedSearch:
    """Finds the target by a search and a tracker: ports.Acquirer of either sensor."""

    def __init__(self, search: Search[Any], tracker: Tracker[Any], limits: VerificationConfig) -> None:
        self._search, self._tracker, self._limits = search, tracker, limits

    def acquire(self, measurement: LidarScan | PmdFrame) -> Acquisition:
        """Return the believed candidate that is chosen, else the first of all with its doubt."""
        return self._judged(measurement, self._search.search(measurement))

    def near(self, measurement: LidarScan | PmdFrame, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the same of candidates around a pose."""
        return self._judged(measurement, self._search.near(measurement, T_sensor_target))

    def _judged(self, measurement: LidarScan | PmdFrame, found: Candidates) -> Acquisition:
        registration, why = self._best(measurement, found)
        pose = None if why else registration.T_sensor_target
        return Acquisition(
            verdict=Verdict.FAILED if pose is None else Verdict.ACCEPTED,
            registration=registration,
            reason=why,
            hypotheses=() if pose is None else (Hypothesis(pose=pose, weight=1.0),),
            templates=found.templates,
            excluded_share=found.excluded_share,
        )

    def _best(self, measurement: LidarScan | PmdFrame, found: Candidates) -> tuple[Registration, str]:
        if not found.poses:
            return Registration(Source.NONE), "the search found nothing to work on"
        limits = self._limits
        believed: list[Registration] = []
        refused: list[tuple[Registration, str]] = []
        for candidate in found.poses[: limits.candidates]:
            registration = self._tracker.track(measurement, candidate.T_sensor_target)
            why = doubt(registration, limits)
            if why:
                refused.append((registration, f"not believed: {why}"))
            elif limits.choice == "first":
                return registration, ""
            else:
                believed.append(registration)
        return (max(believed, key=_explained), "") if believed else refused[0]


def _explained(registration: Registration) -> float:
    share = registration.explained_share
    return 0.0 if np.isnan(share) else share
