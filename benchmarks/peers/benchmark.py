"""The benchmark itself: cases, one way to run a peer, one criterion. It knows no peer's package.

What is measured may be a LIDAR's scan, made here, or a camera's frame, made in ``camera``.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import median
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.report.statistics import rate
from rpod_campaign.lidar.scene import emulator_of, random_pose, scan_of
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import Float32Array, LidarScan
from rpod_target import Target

START_DEG, START_M = 5.0, 0.3
"""Error of the pose that tracking starts from."""

SceneT = TypeVar("SceneT")
ViewT = TypeVar("ViewT")
Register = Callable[[ViewT, RigidTransform], RigidTransform | None]
"""From a scan or frame and a start to T_sensor_target, or None. Acquisition makes no use of the start."""


class Returns(Protocol):
    """What a peer that takes points sees of a scan or a frame."""

    @property
    def returns_m(self) -> Float32Array:
        """Points in sensor axes, shape (N, 3)."""
        ...


@dataclass(frozen=True)
class Criterion:
    """What makes a pose a success."""

    attitude_deg: float
    position_m: float = math.inf

    def met(self, outcome: "Outcome") -> bool:
        """Return whether a pose is right."""
        if outcome.error_deg is None or outcome.error_m is None:
            return False
        return outcome.error_deg < self.attitude_deg and outcome.error_m < self.position_m


@dataclass(frozen=True)
class Clouds:
    """What all peers of a table are given."""

    name: str
    criterion: Criterion


LIDAR = Clouds("lidar", Criterion(3.0))
"""The criterion is that of Opromolla et al., Sensors 15(3), 2015, section 4.3."""


class Task(StrEnum):
    """What is asked of a peer."""

    ACQUISITION = "acquisition"
    """No pose is known; the peer's answer is refined by the same ICP for all, outside its time."""
    TRACKING = "tracking"
    """From START_DEG and START_M; the peer's answer counts as it is."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What a peer may know before the first scan."""

    target: Target
    lidar: LidarConfig
    range_m: float

    @property
    def spacing_m(self) -> float:
        """Distance of neighbouring returns from a surface that is seen squarely."""
        return self.range_m * float(np.deg2rad(self.lidar.pattern.step_deg))


@dataclass(frozen=True)
class Peer(Generic[SceneT, ViewT]):
    """A method that takes part."""

    name: str
    package: str
    """The distribution that it comes from."""
    task: Task
    setup: str
    """How it is set up, and what was tuned."""
    build: Callable[[SceneT], Register[ViewT]]


@dataclass(frozen=True, eq=False)
class Case(Generic[ViewT]):
    """One trial."""

    view: ViewT
    truth: RigidTransform
    """T_sensor_target."""
    start: RigidTransform
    """T_sensor_target that tracking starts from."""


@dataclass(frozen=True)
class Outcome:
    """What a peer made of a case."""

    error_deg: float | None
    """Attitude error; None where there is no pose."""
    error_m: float | None
    """Position error; None where there is no pose."""
    took_s: float
    """Processor time, of all threads, so that other work on the machine does not count."""


@dataclass(frozen=True)
class Score:
    """A peer at one range, or from one start, as ``--json`` prints it."""

    clouds: str
    task: Task
    peer: str
    package: str
    range_m: float | None
    """None where ranges are drawn."""
    start: str
    """How far off tracking starts; empty for acquisition."""
    trials: int
    no_pose: int
    success_rate: float
    wilson_low: float
    wilson_high: float
    median_s: float
    median_error_deg: float | None
    """Median over the successes; None without any."""
    median_error_m: float | None
    """Median over the successes; None without any."""


def cases(scene: Scene, *, seed: int, trials: int) -> Iterator[Case[LidarScan]]:
    """Yield trials: random attitudes, Euler angles uniform, none of the target nearer than 2 m."""
    emulator = emulator_of(scene.target.name, scene.lidar, seed)
    for trial in range(trials):
        drawn = random_pose(
            scene.target.name, range_m=scene.range_m, sampling="euler", seed=seed, trial=trial
        )
        truth = drawn.T_sensor_target
        start = disturbed(truth, np.random.default_rng((seed, trial, 1)))
        yield Case(scan_of(emulator, truth, trial=trial), truth, start)


def disturbed(
    pose: RigidTransform,
    generator: np.random.Generator,
    *,
    angle_deg: float = START_DEG,
    distance_m: float = START_M,
) -> RigidTransform:
    """Return a pose that is off by an angle and a distance in random directions."""
    turn, shift = (vector / np.linalg.norm(vector) for vector in generator.normal(size=(2, 3)))
    return make_pose(
        rotation=Rotation.from_rotvec(np.deg2rad(angle_deg) * turn) * pose.rotation,
        translation_m=pose.translation + distance_m * shift,
    )


def start_of(angle_deg: float, distance_m: float) -> str:
    """Return a start as tables show it."""
    return f"{angle_deg:g} deg, {100.0 * distance_m:g} cm"


def run(
    register: Register[ViewT], trials: Iterable[Case[ViewT]], *, finish: Register[ViewT] | None
) -> list[Outcome]:
    """Return what a peer makes of cases; ``finish`` refines its poses, not timed; none of it is none."""
    return [_outcome(register, case, finish) for case in trials]


def _outcome(register: Register[ViewT], case: Case[ViewT], finish: Register[ViewT] | None) -> Outcome:
    begin_s = time.process_time()
    pose = register(case.view, case.start)
    took_s = time.process_time() - begin_s
    if pose is not None and finish is not None:
        pose = finish(case.view, pose)
    if pose is None:
        return Outcome(None, None, took_s)
    attitude_rad, position_m = pose_error(case.truth, pose)
    attitude_deg = float(np.rad2deg(np.linalg.norm(attitude_rad)))
    return Outcome(attitude_deg, float(np.linalg.norm(position_m)), took_s)


def score(
    peer: Peer[SceneT, ViewT],
    outcomes: Sequence[Outcome],
    *,
    clouds: Clouds = LIDAR,
    range_m: float | None = None,
    start: str = "",
) -> Score:
    """Return a peer's figures.

    Raises:
        StatisticsError: there is no outcome.
    """
    right = [outcome for outcome in outcomes if clouds.criterion.met(outcome)]
    share = rate(len(right), len(outcomes))
    return Score(
        clouds=clouds.name,
        task=peer.task,
        peer=peer.name,
        package=peer.package,
        range_m=range_m,
        start=start,
        trials=len(outcomes),
        no_pose=sum(outcome.error_deg is None for outcome in outcomes),
        success_rate=share.value,
        wilson_low=share.low,
        wilson_high=share.high,
        median_s=median(outcome.took_s for outcome in outcomes),
        median_error_deg=_median([outcome.error_deg for outcome in right]),
        median_error_m=_median([outcome.error_m for outcome in right]),
    )


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None
