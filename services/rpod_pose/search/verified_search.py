"""Acquisition by a search: the tracker refines and checks its candidates, and one of them is chosen."""

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import contradicted
from rpod_pose.cancellation import stop_if_cancelled
from rpod_pose.ports import Acquisition, Candidates, Registration, Search, Tracker
from rpod_schemas.types import SensorFrame, Source


class VerifiedSearch:
    """Finds the target by a search and a tracker: ports.Acquirer of any sensor.

    Args:
        search: proposes candidates.
        tracker: refines and checks them.
        choice: which accepted candidate is taken: the first, or the one with the largest explained share.
    """

    def __init__(
        self, search: Search[Any], tracker: Tracker[Any], choice: Literal["first", "best_explained"]
    ) -> None:
        self._search, self._tracker, self._choice = search, tracker, choice

    def acquire(self, measurement: SensorFrame) -> Acquisition:
        """Return the chosen candidate; if none is accepted, the first one with the reason."""
        return self._checked(measurement, self._search.search(measurement))

    def near(self, measurement: SensorFrame, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the chosen candidate near a pose; if none is accepted, the first one with the reason."""
        return self._checked(measurement, self._search.near(measurement, T_sensor_target))

    def _checked(self, measurement: SensorFrame, found: Candidates) -> Acquisition:
        registration = self._best(measurement, found)
        return Acquisition(registration, templates=found.templates, excluded_share=found.excluded_share)

    def _best(self, measurement: SensorFrame, found: Candidates) -> Registration:
        if not found.poses:
            return Registration.none(Source.NONE, "the search found too few points of the target")
        accepted: list[Registration] = []
        refused: list[Registration] = []
        for candidate in found.poses:
            stop_if_cancelled()
            registration = self._tracker.track(measurement, candidate.T_sensor_target)
            if not registration.begins_track:
                refused.append(registration)
            elif self._choice == "first":
                return registration
            else:
                accepted.append(registration)
        return max(accepted, key=_explained) if accepted else _refused(refused[0])


def _explained(registration: Registration) -> float:
    share = registration.explained_share
    return 0.0 if np.isnan(share) else share


def _refused(registration: Registration) -> Registration:
    """Return a refused registration, contradicted, with the reason in its belief."""
    belief = registration.belief
    return replace(registration, belief=contradicted(f"not accepted: {belief.refusal}", **belief.evidence))
