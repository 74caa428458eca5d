"""The benchmark itself: cases, one way to run a peer, one criterion. It knows no peer's package."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import median

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.campaign.statistics import rate
from rpod_analysis.campaign.trials.scene import emulator_of, random_pose, scan_of
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import LidarScan
from rpod_target import Target

SUCCESS_DEG = 3.0
"""Largest attitude error of a success (Opromolla et al., Sensors 15(3), 2015, section 4.3)."""
START_DEG, START_M = 5.0, 0.3
"""Error of the pose that tracking starts from."""
CLOUDS = "lidar"
"""Name of the clouds in the results; those of a camera would be another."""

Register = Callable[[LidarScan, RigidTransform], RigidTransform | None]
"""From a scan and a start to T_sensor_target, or None. Acquisition makes no use of the start."""


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
class Peer:
    """A method that takes part."""

    name: str
    package: str
    """The distribution that it comes from."""
    task: Task
    setup: str
    """How it is set up, and what was tuned."""
    build: Callable[[Scene], Register]


@dataclass(frozen=True, eq=False)
class Case:
    """One trial."""

    scan: LidarScan
    truth: RigidTransform
    """T_sensor_target."""
    start: RigidTransform
    """T_sensor_target that tracking starts from."""


@dataclass(frozen=True)
class Outcome:
    """What a peer made of a case."""

    error_deg: float | None
    """Attitude error; None where there is no pose."""
    took_s: float
    """Processor time, of all threads, so that other work on the machine does not count."""

    @property
    def success(self) -> bool:
        """Whether the attitude is right."""
        return self.error_deg is not None and self.error_deg < SUCCESS_DEG


@dataclass(frozen=True)
class Score:
    """A peer at one range, as ``--json`` prints it."""

    clouds: str
    task: Task
    peer: str
    package: str
    range_m: float
    trials: int
    no_pose: int
    success_rate: float
    wilson_low: float
    wilson_high: float
    median_s: float
    median_error_deg: float | None
    """Of the successes; None without any."""


def cases(scene: Scene, *, seed: int, trials: int) -> Iterator[Case]:
    """Yield trials: random attitudes, Euler angles uniform, none of the target nearer than 2 m."""
    emulator = emulator_of(scene.target.name, scene.lidar, seed)
    for trial in range(trials):
        drawn = random_pose(
            scene.target.name, range_m=scene.range_m, sampling="euler", seed=seed, trial=trial
        )
        truth = drawn.T_sensor_target
        start = disturbed(truth, np.random.default_rng((seed, trial, 1)))
        yield Case(scan_of(emulator, truth, trial=trial), truth, start)


def disturbed(pose: RigidTransform, generator: np.random.Generator) -> RigidTransform:
    """Return a pose that is off by START_DEG and START_M in random directions."""
    turn, shift = (vector / np.linalg.norm(vector) for vector in generator.normal(size=(2, 3)))
    return make_pose(
        rotation=Rotation.from_rotvec(np.deg2rad(START_DEG) * turn) * pose.rotation,
        translation_m=pose.translation + START_M * shift,
    )


def run(register: Register, trials: Iterable[Case], *, finish: Register | None) -> list[Outcome]:
    """Return what a peer makes of cases; ``finish`` refines its poses, not timed; none of it is none."""
    return [_outcome(register, case, finish) for case in trials]


def _outcome(register: Register, case: Case, finish: Register | None) -> Outcome:
    begin_s = time.process_time()
    pose = register(case.scan, case.start)
    took_s = time.process_time() - begin_s
    if pose is not None and finish is not None:
        pose = finish(case.scan, pose)
    if pose is None:
        return Outcome(None, took_s)
    attitude_rad, _ = pose_error(case.truth, pose)
    return Outcome(float(np.rad2deg(np.linalg.norm(attitude_rad))), took_s)


def score(peer: Peer, range_m: float, outcomes: Sequence[Outcome]) -> Score:
    """Return a peer's figures.

    Raises:
        StatisticsError: there is no outcome.
    """
    right_deg = [
        outcome.error_deg for outcome in outcomes if outcome.success and outcome.error_deg is not None
    ]
    share = rate(len(right_deg), len(outcomes))
    return Score(
        clouds=CLOUDS,
        task=peer.task,
        peer=peer.name,
        package=peer.package,
        range_m=range_m,
        trials=len(outcomes),
        no_pose=sum(outcome.error_deg is None for outcome in outcomes),
        success_rate=share.value,
        wilson_low=share.low,
        wilson_high=share.high,
        median_s=median(outcome.took_s for outcome in outcomes),
        median_error_deg=median(right_deg) if right_deg else None,
    )
