"""The methods of the camera: a tracker by edges, and a wide search near a prediction for an acquisition."""

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_mono_camera.config import EdgeTrackingConfig, NearPredictionConfig
from rpod_mono_camera.edges import Edges, Found, find
from rpod_mono_camera.frame import MonoFrame
from rpod_pose.belief import Belief, contradicted, doubtful
from rpod_pose.ports import Acquisition, KindMethods, Methods, Registration, Task
from rpod_schemas.arrays import FloatArray
from rpod_schemas.sensors import method
from rpod_schemas.types import Camera, Float32Array, Source
from rpod_target import Target

_SCALE = 0.3
"""Geman-McClure scale of a residual over the reach of its search."""
_HELD = np.repeat((1.0 / 0.5**2, 1.0 / 0.1**2), 3)
"""Information that holds what no edge determines: 0.5 m and 0.1 rad a step."""
_WIDER = 3.0
"""Reach of the search near a prediction over that of tracking."""
_LIT = 0.15
"""Pixels brighter than this share of the brightest are taken for the target's."""
_RECAST = 3
"""Steps after which it is asked again which edges show."""


class EdgeTracker:
    """Registers images: rpod_pose.ports.Tracker[MonoFrame]."""

    def __init__(self, config: EdgeTrackingConfig, target: Target) -> None:
        self._config, self._target = config, target

    def track(self, measurement: MonoFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why there is none."""
        return self.search(measurement, T_sensor_target, self._config.search_px)

    def search(
        self, measurement: MonoFrame, T_sensor_target: RigidTransform, reach_px: float
    ) -> Registration:
        """Return the registration from a pose whose edges are at most so far off."""
        config, pose = self._config, T_sensor_target
        image = gaussian_filter(measurement.brightness, config.blur_px)
        least = config.min_contrast * _typical(image)
        edges = Edges.shown(self._target, pose)
        for step, reach in enumerate(np.geomspace(reach_px, config.final_search_px, config.steps)):
            if step and step % _RECAST == 0:
                edges = Edges.shown(self._target, pose)
            found = find(edges, pose, measurement.camera, image, reach=reach, least=least)
            if len(found.offset_px) < config.min_edges:
                text = f"{len(found.offset_px)} of {found.asked} edge samples found, limit {config.min_edges}"
                return Registration.none(Source.OTHER, text, iterations=step)
            weight = _weights(found, reach)
            pose = pose * _step(found, weight)
        return self._judged(found, _SCALE * reach, pose)

    def _judged(self, found: Found, scale_px: float, pose: RigidTransform) -> Registration:
        config = self._config
        near = np.abs(found.offset_px) < scale_px
        count, share = int(near.sum()), float(near.sum() / max(found.asked, 1))
        variance_px2 = max(float(np.mean(found.offset_px[near] ** 2)) if count else 0.0, config.sigma_px**2)
        rows = found.rows[near]
        per_px2 = min(1.0, config.effective_edges / max(count, 1)) / variance_px2
        information = per_px2 * np.einsum("ni,nj->ij", rows, rows)
        evidence = {"edges_in_place_share": share, "edges_rms_px": variance_px2**0.5}
        return Registration(
            Source.OTHER,
            pose,
            self._belief(count, share, evidence),
            inliers=count,
            inlier_share=share,
            covariance=_in_sensor(np.linalg.inv(information + np.diag(1e-3 * _HELD)), pose),
            iterations=config.steps,
        )

    def _belief(self, count: int, share: float, evidence: dict[str, float]) -> Belief:
        config = self._config
        if count < config.min_edges:
            return doubtful(f"{count} edge samples in place, limit {config.min_edges}", **evidence)
        if share < 0.5 * config.min_found_share:
            return contradicted(f"{share:.0%} of the edges in place", **evidence)
        if share < config.min_found_share:
            text = f"{share:.0%} of the edges in place, limit {config.min_found_share:.0%}"
            return doubtful(text, **evidence)
        return Belief(evidence=evidence)


class NearPrediction:
    """Searches around a prediction: rpod_pose.ports.Acquirer[MonoFrame]."""

    def __init__(self, tracker: EdgeTracker, reach_px: float) -> None:
        self._tracker, self._reach_px = tracker, reach_px

    def acquire(self, measurement: MonoFrame) -> Acquisition:  # noqa: ARG002 - there is no search
        """Find nothing: one image without a guess is not searched."""
        text = "a monocular camera needs a first pose: give initial_pose, or a sensor that acquires"
        return Acquisition(Registration.none(Source.OTHER, text))

    def near(self, measurement: MonoFrame, T_sensor_target: RigidTransform) -> Acquisition:
        """Track with a wide search."""
        return Acquisition(self._tracker.search(measurement, T_sensor_target, self._reach_px))


def edges(config: EdgeTrackingConfig, task: Task) -> EdgeTracker:
    """Return the tracker."""
    return EdgeTracker(config, task.target)


def near_prediction(_: NearPredictionConfig, task: Task) -> NearPrediction:
    """Return the search near a prediction; it tracks by edges whatever the sensor is tracked with."""
    config = task.sensor.tracking
    config = config if isinstance(config, EdgeTrackingConfig) else EdgeTrackingConfig()
    return NearPrediction(EdgeTracker(config, task.target), _WIDER * config.search_px)


def make(task: Task) -> Methods:
    """Return the configured methods."""
    sensor = task.sensor
    tracker = method("mono", sensor.tracking.kind).built(sensor.tracking, task)
    acquirer = method("mono", sensor.acquisition.kind).built(sensor.acquisition, task.with_tracker(tracker))
    return Methods(acquirer, tracker)


def ideal_frames(target: Target, T_optical_target: RigidTransform, _: object) -> tuple[MonoFrame]:
    """Return an image without noise, lit from the camera."""
    camera = Camera(width=320, height=240, fx=450.0, fy=450.0, cx=159.5, cy=119.5)
    grid = RayGrid.pinhole(camera)
    hits = cast(grid, target.triangles_m, T_optical_target)
    normals = T_optical_target.rotation.apply(target.normals)[hits.triangle]
    shade = np.abs((normals * grid.directions).sum(axis=-1))
    image = np.where(hits.triangle >= 0, 3000.0 * shade, 0.0).astype(np.uint16)
    return (MonoFrame(stamp_ns=0, frame_id="", image=image, camera=camera),)


MONO_METHODS = KindMethods(make=make, frames=ideal_frames)


def _typical(image: Float32Array) -> float:
    """Return the median brightness of the target, by the pixels that are no sky."""
    dark, bright = np.percentile(image, (5.0, 99.5))
    lit = image[image > dark + _LIT * (bright - dark)]
    return float(np.median(lit) - dark) if lit.size else 1.0


def _weights(found: Found, reach: float) -> FloatArray:
    c2 = (_SCALE * reach) ** 2
    weights: FloatArray = (c2 / (c2 + found.offset_px**2)) ** 2
    return weights


def _step(found: Found, weight: FloatArray) -> RigidTransform:
    """Return the Gauss-Newton step, a right perturbation (dtau, dtheta) in target axes."""
    information = np.einsum("n,ni,nj->ij", weight, found.rows, found.rows)  # in one order on any machine
    gradient = np.einsum("n,ni,n->i", weight, found.rows, found.offset_px)
    step = np.linalg.solve(information + np.diag(_HELD), gradient)
    return RigidTransform.from_components(step[:3], Rotation.from_rotvec(step[3:]))


def _in_sensor(covariance: FloatArray, pose: RigidTransform) -> FloatArray:
    """Return a covariance of (dtau, dtheta) in target axes as one of (dp, dtheta) in the sensor's."""
    turn = np.kron(np.eye(2), pose.rotation.as_matrix())
    turned: FloatArray = turn @ covariance @ turn.T
    return turned
