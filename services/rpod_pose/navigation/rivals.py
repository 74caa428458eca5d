"""Rivals of an ambiguous first pose: tracked in parallel until one remains.

Each rival has a filter of its own. Each frame adds to the logarithm of a rival's evidence. It adds the log
likelihood of the frame at the pose that the tracker found, by the same model of the sensor by which a search
weighs its hypotheses. Errors of successive frames are correlated. Therefore at most half of a frame's log
likelihood counts, whatever the rate (or one part in ``correlation_inflation``, if the filter's ``tuning``
sets it), and all frames within ``CORRELATED_S`` count at most as one.

Only differences between rivals matter. A rival is excluded when a frame that another rival explains
contradicts it, or when the filter's gate rejects its motion. Attitudes that no measurement distinguishes are
one rival. Each rival has tracks of its own for the angles of the target's joints: the attitude that is turned
by a half turn explains a frame at other angles than the right one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import degrees, log, radians
from typing import NamedTuple, Self

import numpy as np
from scipy.special import softmax

from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.history import History
from rpod_pose.navigation.joints import JointTrack
from rpod_pose.search.same_state import State, are_same
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import rotation_matrix
from rpod_schemas.types import Hypothesis
from rpod_target import Equivalence

CORRELATED_S = 1.0
"""Time within which two frames show the same errors of model and sensor, s. Hand: a longer time decides
later; a shorter one counts the same error of a model often."""
SAME_DEG = 5.0
"""Angle between two attitudes, and between angles of a joint that are well known, deg, below which they are
the same rival. Hand: above the errors of tracked poses, below the turns of near-symmetries."""


@dataclass(frozen=True, eq=False)
class Rival:
    """A pose that may be right, and its track."""

    history: History
    log_evidence: float
    """Logarithm of the evidence, up to a constant that all rivals share."""
    joints: Mapping[str, JointTrack] = field(default_factory=dict)
    """Angles of the target's joints at this pose, by name."""

    @property
    def state(self) -> FilterState:
        """State of its filter at the newest frame."""
        return self.history.state

    @property
    def at_angles(self) -> str:
        """The angles of the joints, for the operator; empty for a target without joints."""
        return "".join(
            f", {name} at {degrees(track.angle.angle_rad):.0f} deg" for name, track in self.joints.items()
        )


class Rivals(NamedTuple):
    """The rivals that are left, best first; at least one."""

    tracks: tuple[Rival, ...]
    sensor: str
    """Sensor that measured the ambiguous first pose; another sensor may not see the target."""
    since_ns: int
    """Stamp of the ambiguous first pose."""
    newest_ns: int
    """Stamp of the newest frame that counted."""
    needed: float
    """Least weight at which the best rival is believed; it is that of a first pose."""
    frames: int = 0
    """Number of frames in which the rivals were tracked."""

    @property
    def weights(self) -> FloatArray:
        """Probabilities of the rivals, which sum to 1, shape (N,)."""
        weights: FloatArray = softmax([track.log_evidence for track in self.tracks])
        return weights

    @property
    def decided(self) -> bool:
        """Whether the best rival is probable enough to be believed."""
        return bool(self.weights[0] >= self.needed)

    def share_of_frame(self, stamp_ns: int, inflation: float) -> float:
        """Return how much of a frame's log likelihood is new.

        Args:
            stamp_ns: stamp of the frame.
            inflation: factor by which a frame counts less (``FilterConfig.inflation`` without a rate).
        """
        return min(1.0 / inflation, max(stamp_ns - self.newest_ns, 0) * 1e-9 / CORRELATED_S)

    def hypotheses(self, alike: Equivalence) -> tuple[Hypothesis, ...]:
        """Return the rivals' T_chaser_target with their weights, best first."""
        turned = (f"turned by {angle:.0f} deg" for angle in self.turned_deg(alike))
        others = (f"{turn}{track.at_angles}" for turn, track in zip(turned, self.tracks[1:], strict=True))
        best = self.tracks[0].log_evidence
        return tuple(
            Hypothesis(
                pose=track.state.T_chaser_target,
                weight=float(weight),
                name=name,
                log_likelihood=track.log_evidence - best,
            )
            for track, weight, name in zip(self.tracks, self.weights, ("", *others), strict=True)
        )

    def turned_deg(self, alike: Equivalence) -> list[float]:
        """Return the angles of the others from the best, modulo the exact symmetries, deg."""
        best, *others = (_attitude(track) for track in self.tracks)
        cosines = alike.cosines(best[None], np.array(others).reshape(-1, 3, 3))[0]
        turned_deg: list[float] = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))).tolist()
        return turned_deg

    def reason(self, alike: Equivalence) -> str:
        """Return why no pose is believed yet, with figures."""
        angles = ", ".join(f"{angle:.0f}" for angle in self.turned_deg(alike))
        others = f", turned by {angles} deg from the best" if angles else ""
        return (
            f"{len(self.tracks)} rival{'s are' if others else ' is'} tracked in parallel{others}: "
            f"the best has weight {self.weights[0]:.3f}, {self.needed:g} needed; {REMEDY}"
        )

    @property
    def evidence(self) -> dict[str, float]:
        """Numbers for the operator, by name."""
        best, *others = (track.log_evidence for track in self.tracks)
        lead = {"rivals_lead_log_likelihood": best - others[0]} if others else {}
        return {"rivals": float(len(self.tracks)), "rivals_best_weight": float(self.weights[0]), **lead}

    def joined_by(self, found: Sequence[Rival], alike: Equivalence) -> Self:
        """Return the rivals together with the new ones that a search in the newest frame has found.

        Only this frame compares a new rival with the best one: before it, both count as equally probable.

        Args:
            found: poses that explain the frame; their evidence is that of this frame alone.
            alike: which attitudes no measurement distinguishes.
        """
        best = self.tracks[0]
        of_best = [each.log_evidence for each in found if _are_same(each, best, alike)]
        offset = best.log_evidence - max(of_best, default=UNLISTED)
        new = [
            replace(each, log_evidence=each.log_evidence + offset)
            for each in found
            if not any(_are_same(each, track, alike) for track in self.tracks)
        ]
        return self._replace(tracks=distinct((*self.tracks, *new), alike))


REMEDY = (
    "show another side or come nearer; a turn that does not matter may stand as exact among the symmetries "
    "of the target file"
)
"""Remedy where rivals remain, for the operator."""
UNLISTED = log(1e-3)
"""Log likelihood of a pose that a search does not list, relative to its best (``hypotheses.NEGLIGIBLE``).
Numerics: the least weight that a search lists."""


def distinct(tracks: Sequence[Rival], alike: Equivalence) -> tuple[Rival, ...]:
    """Return rivals, best first, without those that have the attitude and angles of a better one."""
    kept: list[Rival] = []
    for track in sorted(tracks, key=lambda each: -each.log_evidence):
        if not any(_are_same(track, better, alike) for better in kept):
            kept.append(track)
    return tuple(kept)


def _are_same(one: Rival, other: Rival, alike: Equivalence) -> bool:
    axes = {name: track.joint.axis for name, track in one.joints.items()}
    return are_same(_shown(one), _shown(other), alike=alike, axes=axes, within_rad=radians(SAME_DEG))


def _shown(track: Rival) -> State:
    return State(_attitude(track), {name: joint.angle for name, joint in track.joints.items()})


def _attitude(track: Rival) -> FloatArray:
    return rotation_matrix(track.state.T_chaser_target)
