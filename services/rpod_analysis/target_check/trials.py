"""Methods tried on a target: every installed sensor kind emulates frames, and its methods find the target.

A few frames say whether a method can use the target at all; campaigns measure how well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from rpod_analysis.scoring.score import find_nees
from rpod_analysis.target_check.clocks import Clocks, clocks
from rpod_analysis.target_check.conditions import Condition, conditions
from rpod_analysis.target_check.emulated import EmulatedKind, measured_points
from rpod_pose.methods import kind_methods
from rpod_pose.ports import Acquisition, Task
from rpod_schemas.errors import SchemaError
from rpod_schemas.poses import pose_error
from rpod_schemas.sensors import Method, SensorKind, methods, sensor_kinds
from rpod_schemas.types import BeliefLevel, SensorFrame
from rpod_target import Target

TRIALS = 12
"""Number of frames of each sensor on which its default methods are tried."""
_OTHERS = 3
"""One frame in this number is tried by the other methods of its sensor, too."""
_LONGEST_S = 20.0
"""Processor time of all trials after which no further frame is tried, unless their number is asked for. Each
default method is tried on one frame at least, and on one of each condition until as long again has passed."""
_SEED = 1
_RIGHT_DEG, _RIGHT = 4.0, 0.04
"""Errors of a right pose: attitude, deg, and position over the longest side."""

_FEWEST_RETURNS, _FEWEST_PIXELS = 6, 200
"""Returns of a scan, and pixels with depth of an image, below which a frame cannot fix a pose."""

_ONE_IN_A_HUNDRED = float(chi2.ppf(0.99, 6))
"""NEES that one pose of a hundred exceeds."""

Result = Literal["right", "ambiguous", "refused", "wrong", "unseen"]


@dataclass(frozen=True)
class Answers:
    """Answers of a method to some frames."""

    condition: str
    """Condition of the frames, such as "30 returns"."""
    range_m: float | None
    """Median range; None without a frame."""
    frames: int
    right: int
    """Poses that were accepted and are within 4 deg and 4 % of the longest side, modulo exact symmetries."""
    ambiguous: int
    """Frames with several hypotheses, the truth among them."""
    refused: int
    """Frames without an accepted pose and without such hypotheses."""
    refused_right: int
    """Refused frames whose pose was right."""
    wrong: int
    """Poses that were accepted and are not right."""
    wrong_coarse: int
    """Wrong ones that are no farther off than one in a hundred is by their own covariance."""
    unseen: int
    """Frames without an accepted pose that hold fewer than 6 returns or 200 pixels of depth."""
    attitude_deg: float | None
    """Median error of the accepted poses' attitudes, deg; None without one."""
    position_m: float | None
    """Median error of the accepted poses' positions, m; None without one."""


@dataclass(frozen=True)
class MethodFacts:
    """Results of a method with its default configuration on the target."""

    sensor: str
    role: str
    name: str
    default: bool
    """Whether a sensor of the kind uses the method if its configuration names none."""
    works: bool | None
    """Whether at least half of the frames are right, or ambiguous with the truth among the hypotheses.

    Frames in which nothing is seen do not count. None if the method was not tried."""
    reason: str
    """Why the method cannot be made, or else the first reason for which it refused a frame."""
    total: Answers
    by_condition: tuple[Answers, ...]
    median_ms: float | None
    """Median processing time of a frame, ms; None without a frame."""


@dataclass(frozen=True)
class _Trial:
    condition: str
    range_m: float
    result: Result
    is_right: bool
    is_coarse: bool
    """Whether the pose is wrong, but no farther off than its own covariance says."""
    attitude_deg: float | None
    position_m: float | None
    reason: str
    took_s: float


@dataclass
class _Tried:
    """A method, and its trials."""

    method: Method
    default: bool
    made: Any = None
    """The method; None if it cannot be made."""
    reason: str = ""
    trials: list[_Trial] = field(default_factory=list)


def try_methods(
    target: Target, *, trials: int | None = None, kinds: Sequence[SensorKind] | None = None
) -> tuple[MethodFacts, ...]:
    """Return the results of the methods of sensor kinds on a target; frames are seeded.

    Args:
        target: the target to find and track.
        trials: number of frames of each sensor; by default ``TRIALS``, fewer if they take too long.
        kinds: kinds of sensors; by default all that are installed.
    """
    kinds = sensor_kinds() if kinds is None else kinds
    found: list[MethodFacts] = []
    with clocks() as clock:
        until_s = np.inf if trials else clock.now().processor_s + _LONGEST_S
        for number, kind in enumerate(kinds):
            now_s = clock.now().processor_s
            share_s = (until_s - now_s) / (len(kinds) - number)
            found += _try_kind(kind, target, trials or TRIALS, until_s=now_s + share_s, clock=clock)
    return tuple(found)


def _try_kind(
    kind: SensorKind, target: Target, count: int, *, until_s: float, clock: Clocks
) -> list[MethodFacts]:
    """Return the results of a kind's methods on a target: its default methods first, then the others."""
    emulated = EmulatedKind(kind, target, seed=_SEED)
    seen = [
        (each, emulated.frame(each.T_sensor_target, sun_W_m2=each.sun_W_m2, number=number))
        for number, each in enumerate(conditions(emulated, target, count, seed=_SEED), start=1)
    ]
    names = tuple(dict.fromkeys(condition.name for condition, _ in seen))
    tried = _prepared_methods(emulated, target)
    for one in (each for each in tried if each.default and each.made is not None):
        for number, (condition, frame) in enumerate(seen):
            late_s = until_s + (_LONGEST_S if number < len(names) else 0.0)
            if not one.trials or clock.now().processor_s < late_s:
                one.trials.append(_tried(one, frame, condition, target, clock))
    for condition, frame in seen[: -(-count // _OTHERS)]:
        for one in (each for each in tried if not each.default and each.made is not None):
            if clock.now().processor_s < until_s:
                one.trials.append(_tried(one, frame, condition, target, clock))
            elif not one.trials:
                one.reason = "not tried: the other methods took the time; ask for more with --trials"
    return [_facts(one, names) for one in tried]


def _prepared_methods(emulated: EmulatedKind, target: Target) -> list[_Tried]:
    """Return the kind's methods as an estimator makes them, those for tracking first."""
    heard: Any = emulated.heard
    defaults = {heard.tracking.kind, heard.acquisition.kind}
    found: list[_Tried] = []
    for each in sorted(methods(emulated.kind.name), key=lambda one: one.role != "tracking"):
        one = _Tried(each, each.name in defaults)
        config: Any = each.config
        sensor = heard.model_copy(update={each.role: config()})
        try:
            one.made = _prepared(each, Task(target, sensor, emulated.setup))
        except (SchemaError, ValueError, IndexError) as error:
            one.reason = " ".join(str(error).split())
        found.append(one)
    return found


def _prepared(one: Method, task: Task) -> Any:
    """Return a configured method with what its kind does to frames first, such as unwrapping distances."""
    kind = kind_methods(task.sensor)
    if one.role == "tracking" and kind.tracker is not None:
        return kind.tracker(task)
    made = kind.make(task)
    return made.tracker if one.role == "tracking" else made.acquirer


def _tried(
    one: _Tried, frame: SensorFrame | None, condition: Condition, target: Target, clock: Clocks
) -> _Trial:
    truth = condition.T_sensor_target
    range_m = float(np.linalg.norm(truth.translation))
    if frame is None:
        text = "the sensor measures nothing"
        return _Trial(condition.name, range_m, "unseen", False, False, None, None, text, 0.0)
    begin_s = clock.now().wall_s
    try:
        if one.method.role == "tracking":
            answer = Acquisition(one.made.track(frame, condition.predicted))
            accepted = answer.pose is not None and answer.belief.level is BeliefLevel.ACCEPTED
        else:
            answer = one.made.acquire(frame)
            accepted = answer.begins_track
    except Exception as error:  # noqa: BLE001 - a method must not raise on data; one that does is told
        text = f"raised {type(error).__name__}: {' '.join(str(error).split())}"
        return _Trial(condition.name, range_m, "refused", False, False, None, None, text, 0.0)
    took_s = clock.now().wall_s - begin_s
    attitude_deg, position_m = _error(answer.pose, truth, target)
    right = _is_right(attitude_deg, position_m, target)
    listed = [_error(each.pose, truth, target) for each in answer.hypotheses]
    if accepted:
        result: Result = "right" if right else "wrong"
    else:
        several = len(listed) > 1 and any(_is_right(*each, target) for each in listed)
        result = "ambiguous" if several else "refused" if _measured(frame) else "unseen"
    return _Trial(
        condition.name,
        range_m,
        result,
        right,
        result == "wrong" and _as_stated(answer, truth, target),
        attitude_deg if accepted else None,
        position_m if accepted else None,
        answer.belief.refusal,
        took_s,
    )


def _as_stated(answer: Acquisition, truth: RigidTransform, target: Target) -> bool:
    """Return whether an accepted pose is no farther off than one in a hundred is by its covariance."""
    if answer.pose is None or not np.isfinite(answer.covariance).all():
        return False
    R = answer.pose.rotation.as_matrix()
    attitude_rad, position_m = pose_error(target.equivalence.nearest_pose(truth, answer.pose), answer.pose)
    error = np.concatenate((position_m, R @ attitude_rad))
    covariance = target.equivalence.with_free_variance(answer.covariance, R, 1.0)
    return bool(find_nees(error[None], covariance[None])[0] < _ONE_IN_A_HUNDRED)


def _measured(frame: SensorFrame) -> bool:
    """Return whether a frame holds enough of the target for a pose."""
    if frame.lens is None:
        return measured_points(frame) >= _FEWEST_RETURNS
    if all(image.scale != "depth" for image in frame.images):
        return True
    return measured_points(frame) >= _FEWEST_PIXELS


def _error(found: RigidTransform | None, truth: RigidTransform, target: Target) -> tuple[float, float]:
    """Return errors of attitude, deg, and position, m, modulo exact symmetries; inf without a pose."""
    return (np.inf, np.inf) if found is None else target.equivalence.error_of(found, truth)


def _is_right(attitude_deg: float, position_m: float, target: Target) -> bool:
    size_m = float(np.ptp(target.triangles_m, axis=(0, 1)).max())
    return attitude_deg < _RIGHT_DEG and position_m < _RIGHT * size_m


def _facts(one: _Tried, names: Sequence[str]) -> MethodFacts:
    refusals = [trial.reason for trial in one.trials if trial.result == "refused" and trial.reason]
    total = _answers("all", one.trials)
    times_s = [trial.took_s for trial in one.trials if trial.took_s > 0.0]
    return MethodFacts(
        one.method.sensor,
        one.method.role,
        one.method.name,
        one.default,
        _works(one, total),
        one.reason or (refusals[0] if refusals else ""),
        total,
        tuple(_answers(name, [trial for trial in one.trials if trial.condition == name]) for name in names),
        1e3 * float(np.median(times_s)) if times_s else None,
    )


def _works(one: _Tried, total: Answers) -> bool | None:
    if total.frames == total.unseen:
        return None if one.made is not None else False
    return total.frames - total.unseen <= 2 * (total.right + total.ambiguous)


def _answers(name: str, trials: Sequence[_Trial]) -> Answers:
    def count(result: Result) -> int:
        return sum(trial.result == result for trial in trials)

    return Answers(
        name,
        _median([trial.range_m for trial in trials]),
        len(trials),
        count("right"),
        count("ambiguous"),
        count("refused"),
        sum(trial.result == "refused" and trial.is_right for trial in trials),
        count("wrong"),
        sum(trial.is_coarse for trial in trials),
        count("unseen"),
        _median([trial.attitude_deg for trial in trials if trial.attitude_deg is not None]),
        _median([trial.position_m for trial in trials if trial.position_m is not None]),
    )


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None
