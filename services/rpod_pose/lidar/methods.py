"""The LIDAR's methods under their names in the registry, and their creation for a scan pattern."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import cast
from rpod_pose.lidar.deskew import deskewed
from rpod_pose.lidar.global_search import GlobalSearch
from rpod_pose.lidar.noisy_ranges import NoisyScanSearch, NoisyScanTracker
from rpod_pose.lidar.paper_2015.icp_nearest_neighbour import NearestNeighbourIcp
from rpod_pose.lidar.paper_2015.template_matching import OnlineTemplateMatching
from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.lidar.scan_view import HIDDEN_M, ScanView, returns_of
from rpod_pose.ports import Acquirer, ComparingAcquirer, KindMethods, Methods, Task, Tracker
from rpod_pose.search.verified_search import VerifiedSearch
from rpod_pose.surroundings.acquirer import AcquirerAmongThings
from rpod_pose.surroundings.separation import Label, RangeImage
from rpod_pose.surroundings.tracker import TrackerAmongThings
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.config.lidar.methods import IcpNearestNeighbourConfig, TemplateMatchingConfig
from rpod_schemas.config.lidar.search import GlobalSearchConfig, ProjectiveIcpConfig
from rpod_schemas.sensors import method
from rpod_schemas.types import Float32Array, LidarInfo, LidarScan
from rpod_target import Target


def global_search(config: GlobalSearchConfig, task: Task) -> Acquirer[LidarScan]:
    """Return the facility's own search; noise that tuning gives is taken as it is."""
    make = partial(GlobalSearch, config, task.target)
    return (
        make(task.setup) if config.tracking.tuning.model.sigma_range_m else NoisyScanSearch(make, task.setup)
    )


def template_matching(config: TemplateMatchingConfig, task: Task) -> Acquirer[LidarScan]:
    """Return the template matching of the 2015 paper; the tracker refines and checks its candidates."""
    assert task.tracker is not None  # noqa: S101 - made before the acquirer
    search = OnlineTemplateMatching(config, task.target, task.setup)
    return VerifiedSearch(search, task.tracker, config.choice)


def projective_point_to_plane(config: ProjectiveIcpConfig, task: Task) -> Tracker[LidarScan]:
    """Return the facility's own tracker; noise that tuning gives is taken as it is."""
    make = partial(ProjectiveIcp, config, task.target)
    return make(task.setup) if config.tuning.model.sigma_range_m else NoisyScanTracker(make, task.setup)


def icp_nearest_neighbour(config: IcpNearestNeighbourConfig, task: Task) -> Tracker[LidarScan]:
    """Return the ICP of the 2015 paper, in the configured variant."""
    return NearestNeighbourIcp(config, task.target, task.setup)


def known_pattern(sensor: LidarInput, info: LidarInfo | None) -> ScanPattern | None:
    """Return the scan pattern of a LIDAR's info, or the configured one; None if neither is known.

    An info that does not state the range noise, such as one that was inferred, has the configured noise.
    """
    stated = info or sensor.configured_info
    if stated is None:
        return None
    pattern = ScanPattern.of(stated)
    return replace(pattern, sigma_range_m=pattern.sigma_range_m or sensor.sigma_range_m or 0.0)


def make_tracker(task: Task) -> Tracker[LidarScan]:
    """Return the configured tracker for a LIDAR with a known scan pattern."""
    return TrackerAmongThings(_tracker(task), ScanFrames(task.setup), task.target, touching=True)


def _tracker(task: Task) -> Tracker[LidarScan]:
    tracker: Tracker[LidarScan] = method("lidar", task.sensor.tracking.kind).built(task.sensor.tracking, task)
    return tracker


def make(task: Task) -> Methods:
    """Return the configured methods for a LIDAR with a known scan pattern."""
    sensor, tracker = task.sensor, _tracker(task)
    task = task.with_tracker(tracker)
    acquirer = method("lidar", sensor.acquisition.kind).built(sensor.acquisition, task)
    likelihoods = acquirer.log_likelihoods if isinstance(acquirer, ComparingAcquirer) else None
    among_things = TrackerAmongThings(tracker, ScanFrames(task.setup), task.target, touching=True)
    searched = AcquirerAmongThings(acquirer, among_things, likelihoods)
    return Methods(searched, among_things, deskewed, likelihoods)


class ScanFrames:
    """Separates scans into the target and other things: surroundings.frames.Frames.

    Args:
        pattern: scan pattern of the LIDAR.
    """

    range_bias_m = 0.0
    """Standard deviation of the error that all ranges of a scan share; none is assumed."""

    def __init__(self, pattern: ScanPattern) -> None:
        self._view = ScanView.of(pattern.azimuth_rad, pattern.elevation_rad, pattern.row_azimuth_rad)

    def image(self, frame: LidarScan, *, fine: bool) -> RangeImage:  # noqa: ARG002 - rays are few
        """Return the range of each ray of the pattern."""
        seen = self._view.seen(frame)
        return RangeImage(seen.grid, seen.range_m.clip(0.0).astype(np.float32), frame.hidden)

    def separated(
        self,
        frame: LidarScan,
        labels: NDArray[np.uint8],
        inside: NDArray[np.bool_],  # noqa: ARG002 - a ray without a return has missed the target
    ) -> LidarScan:
        """Return a scan without the returns of other things.

        Returns of things that hide the target get the coordinates ``HIDDEN_M``. In an organised scan, rays
        without a return get them too if something hides the target there.
        """
        seen = self._view.seen(frame)
        _, places, _ = returns_of(np.ascontiguousarray(frame.points_m.reshape(-1, 3)))
        label = np.where(seen.rays >= 0, labels.flat[seen.rays], Label.BEYOND)
        points_m = frame.points_m.reshape(-1, 3).copy()
        points_m[places[label == Label.BEYOND]] = np.nan
        points_m[places[label == Label.HIDING]] = HIDDEN_M
        if frame.points_m.shape[:-1] == labels.shape:
            points_m[labels.ravel() == Label.HIDING] = HIDDEN_M
        points_m.setflags(write=False)
        return frame.model_copy(update={"points_m": points_m.reshape(frame.points_m.shape)})

    def behind_bodies(self, frame: LidarScan, hides: NDArray[np.bool_]) -> LidarScan:
        """Return a scan without the returns of known bodies; rays that were hidden before stay hidden.

        Args:
            frame: the scan.
            hides: whether a ray of the pattern meets a known body, shape (rows, columns).
        """
        labels = np.where(hides, Label.HIDING, Label.KEPT).astype(np.uint8)
        separated = self.separated(frame, labels, hides)
        hidden = hides if frame.hidden is None else frame.hidden | hides
        return separated.model_copy(update={"hidden": hidden})

    def nearer(self, frame: LidarScan, ratio: float) -> LidarScan:
        """Return a scan whose ranges are divided by a ratio."""
        points_m = np.asarray(frame.points_m / np.float32(ratio), np.float32)
        points_m.setflags(write=False)
        return frame.model_copy(update={"points_m": points_m})

    def part_of(self, part: LidarScan, whole: LidarScan) -> LidarScan:  # noqa: ARG002 - verified afterwards
        """Return a part of a scan."""
        return part

    def whole_of(self, frame: LidarScan) -> None:
        """Return None: a part does not contain the whole scan."""

    def every_range_m(self, frame: LidarScan) -> Float32Array:
        """Return the range of each ray of the pattern."""
        return self._view.seen(frame).range_m.clip(0.0).astype(np.float32)


_FEW_RETURNS = 24
"""Number of returns in the second ideal scan. Numerics: it is below ``projective_icp.MANY``, so that the pose
is the mean of a sampled posterior, whose code is then compiled too."""


def ideal_scan(target: Target, T_lidar_target: RigidTransform, pattern: ScanPattern) -> tuple[LidarScan, ...]:
    """Return two scans without noise for the warm-up: with all returns, and with few of them."""
    grid = pattern.grid
    hits = cast(grid, target.triangles_m, T_lidar_target)
    range_m = np.where(np.isfinite(hits.range_m), hits.range_m, np.nan)
    whole = (range_m[..., None] * grid.directions).astype(np.float32)
    returns = np.argwhere(np.isfinite(range_m))
    few = whole.copy()
    few[tuple(np.delete(returns, np.s_[:: len(returns) // _FEW_RETURNS + 1], axis=0).T)] = np.nan
    return tuple(LidarScan(stamp_ns=0, frame_id="", points_m=points_m) for points_m in (whole, few))


def masked(scan: LidarScan, hit: Callable[[Float32Array], NDArray[np.bool_]]) -> LidarScan:
    """Return a scan without the returns for which a function of their points is true."""
    points_m = np.where(hit(scan.points_m)[..., None], np.float32(np.nan), scan.points_m)
    points_m.setflags(write=False)
    return scan.model_copy(update={"points_m": points_m})


LIDAR_METHODS = KindMethods(
    make=make,
    frames=ideal_scan,
    setup=known_pattern,
    masked=masked,
    separation=lambda _sensor, pattern: ScanFrames(pattern),
    tracker=make_tracker,
    points=lambda scan: scan.returns_m,
    comparable=True,
    missing="no scan pattern: neither lidar info, the points nor the configuration state it; let the driver "
    "publish its info, or set azimuth_rad and elevation_rad of the sensor",
)
