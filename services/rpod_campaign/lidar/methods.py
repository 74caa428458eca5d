"""Methods under trial, by the names of the command line, with a stopwatch on their steps."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from scipy.spatial.transform import RigidTransform

from rpod_pose.lidar.paper_2015.template_matching import OnlineTemplateMatching
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of, warm_up
from rpod_pose.ports import Acquirer, Acquisition, Candidates, Registration, Search, Tracker
from rpod_pose.search.verified_search import VerifiedSearch
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar_methods import TemplateMatchingConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.types import LidarScan
from rpod_target import Target

TEMPLATE_MATCHING: dict[str, dict[str, Any]] = {
    "template-matching": {"variant": "plain"},
    "fast-template-matching": {"variant": "fast"},
    "cued-template-matching": {"variant": "cued"},
}
"""Methods of the 2015 paper, section 2, and the variant that its conclusions call for, with their fields."""
GLOBAL: dict[str, dict[str, Any]] = {
    "global": {},
    "starved-global": {
        "tuning": {"levels": ({"attitudes": 12, "compared": 4, "refined": 2},), "turned": 1, "turns": 1}
    },
}
"""The facility's own search, and the same left with so little to try that it mostly goes wrong."""
METHODS = (*TEMPLATE_MATCHING, *GLOBAL)

MATCHERS: dict[str, dict[str, Any]] = {
    "nearest-neighbour": {"metric": "point_to_point", "gate_m": 1e3},
    "normal-shooting": {"metric": "point_to_point", "gate_m": 1e3, "matcher": "normal_shooting"},
    "nearest-neighbour-plane": {},
}
"""The ICP after template matching: the paper's two, point to point and without a gate for outliers, so that
f_CONV is the mean over all points as in its Table 4; and the facility's own, point to plane with a gate."""

TRACKERS: dict[str, dict[str, Any]] = {
    **{name: {"kind": "icp_nearest_neighbour", **fields} for name, fields in MATCHERS.items()},
    "projective": {"kind": "projective_point_to_plane"},
}
"""All trackers of scans by name."""

PRINTED_SURE_RANGE_M = 150.0
"""Value of ``ScanComparisonConfig.sure_range_m`` if Eq. 4 is read as printed."""


def lidar_config(
    *,
    eq4: str = "usual",
    step_deg: float = 1.0,
    span_deg: float = 40.0,
    detection: Mapping[str, Any] | None = None,
    noise: Mapping[str, Any] | None = None,
) -> LidarConfig:
    """Return the LIDAR of the paper's Table 1 with one reading of Eq. 4.

    Args:
        eq4: usual or printed.
        step_deg: of the scan.
        span_deg: of the scan, both ways; a multiple of the step.
        detection: fields that differ from the paper.
        noise: fields that differ from the paper.
    """
    pattern = {"step_deg": step_deg, "azimuth_span_deg": span_deg, "elevation_span_deg": span_deg}
    return LidarConfig.model_validate(
        {
            "pattern": pattern,
            "detection": {"threshold": eq4, **(detection or {})},
            "noise": noise or {},
            "rate_hz": 1e-3,  # of single scans, which may take long
        }
    )


def lidar_input(
    method: str,
    *,
    step_deg: float | None = None,
    centroid: str | None = None,
    matcher: str | None = None,
    eq4: str = "usual",
) -> LidarInput:
    """Return the configuration of a method; of template matching with Eq. 4 as the sensor reads it.

    Raises:
        ConfigurationError: the method or the matcher is not known.
    """
    if method in GLOBAL:
        acquisition = {"kind": "global", **GLOBAL[method]}
        return check(LidarInput, {"acquisition": acquisition}, source=f"--method {method}")
    if method not in TEMPLATE_MATCHING:
        raise ConfigurationError("--method", "", f"needs {', '.join(METHODS)}, not {method!r}")
    if matcher not in MATCHERS:
        raise ConfigurationError("--matcher", "", f"needs {', '.join(MATCHERS)}, not {matcher!r}")
    sure = {"comparison": {"sure_range_m": PRINTED_SURE_RANGE_M}} if eq4 == "printed" else {}
    document = {
        "acquisition": {
            "kind": "template_matching",
            "step_deg": step_deg,
            "centroid_offset": centroid == "offset",
            "candidates": 1,
            **TEMPLATE_MATCHING[method],
        },
        "tracking": {"kind": "icp_nearest_neighbour", **MATCHERS[matcher], **sure},
    }
    return check(LidarInput, document, source=f"--method {method} --matcher {matcher}")


def tracking_input(tracker: str) -> LidarInput:
    """Return the configuration with a tracker. Raises ConfigurationError."""
    if tracker not in TRACKERS:
        raise ConfigurationError("--matcher", "", f"needs {', '.join(TRACKERS)}, not {tracker!r}")
    return check(LidarInput, {"tracking": TRACKERS[tracker]}, source=f"--matcher {tracker}")


@dataclass
class TimedSearch:
    """A search that remembers what it proposed, and how long that took."""

    search_: Search[LidarScan]
    found: Candidates = field(default_factory=Candidates)
    took_s: float = float("nan")

    def search(self, measurement: LidarScan) -> Candidates:
        """Return what the search proposes."""
        begin_s = time.perf_counter()
        self.found = self.search_.search(measurement)
        self.took_s = time.perf_counter() - begin_s
        return self.found

    def near(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Candidates:
        """Return what the search proposes around a pose."""
        return self.search_.near(measurement, T_sensor_target)


@dataclass
class TimedTracker:
    """A tracker that remembers how long its last call took."""

    tracker: Tracker[LidarScan]
    took_s: float = float("nan")

    def track(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration."""
        begin_s = time.perf_counter()
        registration = self.tracker.track(measurement, T_sensor_target)
        self.took_s = time.perf_counter() - begin_s
        return registration


@dataclass(frozen=True, eq=False)
class TimedAcquisition:
    """Result of one scan, with its times."""

    acquisition: Acquisition
    acquire_s: float
    """Time up to the method's answer; for template matching, of its search alone."""
    icp_s: float | None
    """Time of the ICP after template matching; None if the method refines by itself."""
    template: RigidTransform | None
    """T_sensor_target of the best template before ICP; None of other methods."""


class Acquiring:
    """A method of acquisition under the stopwatch; warmed up when it is made."""

    def __init__(self, sensor: LidarInput, target: Target, pattern: ScanPattern) -> None:
        self.target = target
        methods = methods_of(sensor, target, pattern)
        self._search: TimedSearch | None = None
        self._tracker = TimedTracker(methods.tracker)
        self._acquirer: Acquirer[LidarScan] = methods.acquirer
        if isinstance(sensor.acquisition, TemplateMatchingConfig):
            self._search = TimedSearch(template_search(sensor, target, pattern))
            self._acquirer = VerifiedSearch(self._search, self._tracker, sensor.acquisition.choice)
        warm_up(sensor, methods, target, pattern)

    def acquire(self, scan: LidarScan) -> TimedAcquisition:
        """Return what the method makes of a scan, and how long it took."""
        begin_s = time.perf_counter()
        acquisition = self._acquirer.acquire(scan)
        took_s = time.perf_counter() - begin_s
        if self._search is None:
            return TimedAcquisition(acquisition, took_s, None, None)
        found = self._search.found.poses
        template = found[0].T_sensor_target if found else None
        return TimedAcquisition(
            acquisition, self._search.took_s, self._tracker.took_s if found else None, template
        )


def template_search(sensor: LidarInput, target: Target, pattern: ScanPattern) -> Search[LidarScan]:
    """Return template matching without what refines and judges its templates."""
    if not isinstance(sensor.acquisition, TemplateMatchingConfig):
        raise TypeError(f"{type(sensor.acquisition).__name__} is no template matching")
    return OnlineTemplateMatching(sensor.acquisition, target, pattern)


def pattern_of(config: LidarConfig) -> ScanPattern:
    """Return where a LIDAR looks."""
    return ScanPattern.of(config.info())
