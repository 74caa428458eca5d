"""How far the edges of a target in a camera's images err, over what the frames state of themselves.

A frame does not tell how well the target's file knows its brightness. So emulated frames of the target are
tracked from their true poses. Each frame has another attitude, sun and world, and each part of the target
another brightness, as a user's file may not know it. The factor by which the covariance of the edges' errors
must grow for the poses to be as far off as stated is that of this body.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.optimize import brentq
from scipy.stats import chi2

from rpod_analysis.target_check.conditions import Condition, conditions
from rpod_analysis.target_check.emulated import EmulatedKind, default_tracker
from rpod_emulator.local_sensor import LocalSensor
from rpod_pose.pmd.joint.uncertainty import LASTING
from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig, WorldName
from rpod_schemas.schedule import frame_at
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.types import SensorFrame
from rpod_target import Material, Target, TargetError

FRAMES = 120
"""Number of frames by default: the factor is then known to about a quarter."""
FEWEST = 20
"""Number of accepted poses below which no factor is given: it would be known to less than a factor of 1.7."""
LARGEST = 16.0
"""Largest factor that is given."""
WORLDS: tuple[WorldName, ...] = ("documented", "lambertian", "noisy", "multipath")
"""Worlds of the frames, in turn; the other worlds are kept for reports."""
BRIGHTNESS_LOG = 0.5
"""Standard deviation of the logarithm of a part's brightness: as the estimator assumes for all materials but
mirrors."""
ROUGHNESS_LOG = 0.3
"""Standard deviation of the logarithm of a part's roughness."""
_MOST = float(chi2.ppf(0.999, 6))
"""NEES at which a frame is clipped: a wrong pose must not decide."""
_EXPECTED = float(6.0 * chi2.cdf(_MOST, 8) + _MOST * chi2.sf(_MOST, 6))
"""Mean of the clipped NEES of right covariances, for six unknowns."""
_BOOTSTRAPS, _INTERVAL = 200, (0.05, 0.95)
_EPOCH_NS = 1_000_000_000


@dataclass(frozen=True)
class CameraErrors:
    """The factor of a target, and how it was measured."""

    factor: float
    """Variance of the errors of edges over what a frame states, at least 1."""
    interval: tuple[float, float]
    """Its 90 % interval, by bootstrap over the frames."""
    frames: int
    """Number of poses that it follows from."""
    seed: int
    """Seed of the frames."""
    tried: int
    """Number of emulated frames."""
    nees: float
    """Mean NEES of the poses without the factor; a frame counts at most as 22.5."""
    nees_with: float
    """The same with the factor; 6 is right."""

    def block(self) -> str:
        """Return the lines of a target's parameter file."""
        low, high = self.interval
        return (
            f"camera_errors: {{factor: {self.factor:.3g}, interval: [{low:.3g}, {high:.3g}], "
            f"frames: {self.frames}, seed: {self.seed}}}\n"
        )

    def document(self) -> dict[str, Any]:
        """Return the result as a JSON document."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of poses, and their covariances."""

    errors: FloatArray
    """Errors (dp, dtheta), sensor axes, shape (N, 6)."""
    others: FloatArray
    """Covariances of all errors but those of edges, shape (N, 6, 6)."""
    edges: FloatArray
    """Covariances of the errors of edges, shape (N, 6, 6)."""

    def nees(self, factor: float) -> float:
        """Return the mean clipped NEES with a factor on the covariance of the edges' errors."""
        whole = self.others + factor * self.edges
        found = np.einsum("ni,ni->n", self.errors, np.linalg.solve(whole, self.errors[..., None])[..., 0])
        return float(np.minimum(found, _MOST).mean())

    def factor(self) -> float:
        """Return the factor with which the mean clipped NEES is that of right covariances, 1 to ``LARGEST``.

        It is at least 1: what emulated frames do not show may exist all the same.
        """
        if self.nees(1.0) <= _EXPECTED:
            return 1.0
        if self.nees(LARGEST) >= _EXPECTED:
            return LARGEST
        return float(np.exp(brentq(lambda log: self.nees(np.exp(log)) - _EXPECTED, 0.0, np.log(LARGEST))))

    def interval(self, generator: Generator) -> tuple[float, float]:
        """Return the interval of the factor, by bootstrap over the poses."""
        drawn = [self.drawn(generator).factor() for _ in range(_BOOTSTRAPS)]
        low, high = np.quantile(drawn, _INTERVAL)
        return float(low), float(high)

    def drawn(self, generator: Generator) -> "PoseErrors":
        """Return as many of these poses, drawn with replacement."""
        chosen = generator.integers(len(self.errors), size=len(self.errors))
        return PoseErrors(self.errors[chosen], self.others[chosen], self.edges[chosen])


def measure_camera_errors(target: Target, *, frames: int = FRAMES, seed: int = 1) -> CameraErrors:
    """Return the factor of a target, measured with emulated frames of the default camera.

    Args:
        target: the target; the factor that its file declares does not count.
        frames: number of frames.
        seed: seed of the frames.

    Raises:
        rpod_target.TargetError: too few frames give an accepted pose.
    """
    exact = replace(target, tolerance_m=0.0, scale_tolerance=0.0, camera_errors=None)
    emulated = EmulatedKind(sensor_kind("pmd"), exact, seed=seed)
    tracker, rows = default_tracker(emulated), []
    for condition, frame in _frames(emulated, frames, seed):
        found = None if frame is None else tracker.track(frame, condition.T_sensor_target)
        if found is not None and found.continues_track and found.parts is not None:
            rows.append(_row(found, condition, exact))
    if len(rows) < FEWEST:
        reason = (
            f"cannot be measured: {len(rows)} of {frames} emulated frames give an accepted pose, at least "
            f"{FEWEST} are needed: ask for more frames, and see what 'rpod target check' says of the camera"
        )
        raise TargetError(target.source, "camera_errors", reason)
    known = PoseErrors(*(np.array(column) for column in zip(*rows, strict=True)))
    factor = known.factor()
    interval = known.interval(np.random.default_rng(seed))
    return CameraErrors(
        factor, interval, len(rows), seed, tried=frames, nees=known.nees(1.0), nees_with=known.nees(factor)
    )


def _frames(emulated: EmulatedKind, count: int, seed: int) -> Iterator[tuple[Condition, SensorFrame | None]]:
    """Yield frames of a target whose parts have another brightness in each of them."""
    sensor = emulated.sensor
    for number, condition in enumerate(conditions(emulated, emulated.target, count, seed=seed), start=1):
        generator = np.random.default_rng((seed, number, 1))
        config = EmulatorConfig(
            target=emulated.target.source,
            sensors=(sensor,),
            seed=int(generator.integers(2**31)),
            world=WORLDS[number % len(WORLDS)],
        )
        local = LocalSensor(config, sensor, repainted(emulated.target, generator))
        poses = [condition.T_sensor_target] * len(sensor.pose_times_s())
        sun_W_m2 = sensor.T_chaser_sensor.rotation.apply(condition.sun_W_m2)
        yield condition, local.frame(poses, sun_W_m2, frame_at(sensor, number, epoch_ns=_EPOCH_NS))


def repainted(target: Target, generator: Generator) -> Target:
    """Return a target whose parts have a brightness and roughness of their own; their classes stay."""
    pairs = np.column_stack((target.triangle_part, target.triangle_material))
    used, each = np.unique(pairs, axis=0, return_inverse=True)
    painted = [
        _painted(target.materials[material], f"-{number}", generator)
        for number, (_, material) in enumerate(used)
    ]
    materials = each.ravel().astype(target.triangle_material.dtype)
    return replace(target, materials=tuple(painted), triangle_material=materials)


def _painted(material: Material, suffix: str, generator: Generator) -> Material:
    """Return a material of another brightness and roughness, of the same class."""
    diffuse, specular, roughness = np.exp(
        np.array((BRIGHTNESS_LOG, BRIGHTNESS_LOG, ROUGHNESS_LOG)) * generator.standard_normal(3)
    )
    return replace(
        material,
        name=material.name + suffix,
        diffuse=min(material.diffuse * float(diffuse), 0.95),
        f0=min(material.f0 * float(specular), 0.95),
        roughness=float(np.clip(material.roughness * roughness, 0.05, 1.0)),
        albedo=material.looks,
    )


def _row(
    found: Registration, condition: Condition, target: Target
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the error of a pose, and the covariances of its other errors and of those of its edges."""
    assert found.T_sensor_target is not None  # noqa: S101 - the pose continues a track
    assert found.parts is not None  # noqa: S101 - asked before
    pose, parts = found.T_sensor_target, found.parts
    same = target.equivalence.nearest_pose(condition.T_sensor_target, pose)
    turn = (pose.rotation * same.rotation.inv()).as_rotvec()
    error = np.concatenate((pose.translation - same.translation, turn))
    edges = parts.of_model / LASTING  # without a tolerance of the model
    whole = parts.white + parts.of_sensor + parts.of_image + parts.of_model
    R = pose.rotation.as_matrix()
    return error, target.equivalence.with_free_variance(whole - edges, R, 1.0), edges
