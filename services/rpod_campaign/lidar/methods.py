"""Methods under trial, by the names of the command line, with the times of their steps."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from scipy.spatial.transform import RigidTransform

from rpod_campaign.engine.trial.names import require
from rpod_pose.lidar.paper_2015.template_matching import OnlineTemplateMatching
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of, warm_up
from rpod_pose.ports import Acquirer, Acquisition, Candidates, Registration, Search, Tracker
from rpod_pose.search.verified_search import VerifiedSearch
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar.methods import TemplateMatchingConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.types import LidarScan
from rpod_target import Target

TEMPLATE_MATCHING: dict[str, dict[str, Any]] = {
    "template-matching": {"variant": "plain"},
    "fast-template-matching": {"variant": "fast"},
    "cued-template-matching": {"variant": "cued"},
}
"""Fields of the 2015 paper's methods (section 2), and of the variant that its conclusions propose, by
name."""
GLOBAL: dict[str, dict[str, Any]] = {
    "global": {},
    "starved-global": {
        "tuning": {"levels": ({"attitudes": 12, "compared": 4, "refined": 2},), "turned": 1, "turns": 1}
    },
}
"""Fields of the facility's own search, and of the same with so few attitudes that it mostly fails, by
name."""
METHODS = (*TEMPLATE_MATCHING, *GLOBAL)

MATCHERS: dict[str, dict[str, Any]] = {
    "nearest-neighbour": {"metric": "point_to_point", "gate_m": 1e3},
    "normal-shooting": {"metric": "point_to_point", "gate_m": 1e3, "matcher": "normal_shooting"},
    "nearest-neighbour-plane": {},
}
"""Fields of the ICP after template matching, by name. The paper's two are point to point without a gate for
outliers, so that f_CONV is the mean over all points as in its Table 4. The facility's own is point to plane
with a gate."""

TRACKERS: dict[str, dict[str, Any]] = {
    **{name: {"kind": "icp_nearest_neighbour", **fields} for name, fields in MATCHERS.items()},
    "projective": {"kind": "projective_point_to_plane"},
}
"""Fields of all trackers of scans, by name."""

PRINTED_SURE_RANGE_M = 150.0
"""Value of ``ScanComparisonConfig.sure_range_m`` if Eq. 4 is read as printed, m."""


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
        eq4: reading of Eq. 4, usual or printed.
        step_deg: step of the scan, deg.
        span_deg: span of the scan in both directions, a multiple of the step, deg.
        detection: fields of the detection model that differ from the paper.
        noise: fields of the noise that differ from the paper.
    """
    pattern = {"step_deg": step_deg, "azimuth_span_deg": span_deg, "elevation_span_deg": span_deg}
    return LidarConfig.model_validate(
        {
            "pattern": pattern,
            "detection": {"threshold": eq4, **(detection or {})},
            "noise": noise or {},
            "rate_hz": 1e-3,  # single scans may take long
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
    """Return the configuration of a method; template matching reads Eq. 4 as the sensor does.

    Raises:
        ConfigurationError: the method or the matcher is not known.
    """
    if method in GLOBAL:
        acquisition = {"kind": "global", **GLOBAL[method]}
        return check(LidarInput, {"acquisition": acquisition}, source=f"--method {method}")
    require("--method", method, METHODS)
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
    require("--matcher", tracker, TRACKERS)
    return check(LidarInput, {"tracking": TRACKERS[tracker]}, source=f"--matcher {tracker}")


@dataclass
class TimedSearch:
    """A search that stores its last candidates and their processing time."""

    search_: Search[LidarScan]
    found: Candidates = field(default_factory=Candidates)
    took_s: float = float("nan")

    def search(self, measurement: LidarScan) -> Candidates:
        """Return the candidates of the search."""
        begin_s = time.perf_counter()
        self.found = self.search_.search(measurement)
        self.took_s = time.perf_counter() - begin_s
        return self.found

    def near(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Candidates:
        """Return the candidates of the search near a pose."""
        return self.search_.near(measurement, T_sensor_target)


@dataclass
class TimedTracker:
    """A tracker that stores the processing time of its last call."""

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
    """Acquisition from one scan, with its processing times."""

    acquisition: Acquisition
    acquire_s: float
    """Time up to the method's answer, s; for template matching, of its search alone."""
    icp_s: float | None
    """Time of the ICP after template matching, s; None if the method refines by itself."""
    template: RigidTransform | None
    """T_sensor_target of the best template before ICP; None for other methods."""


class Acquiring:
    """A timed method of acquisition, which is warmed up when it is made."""

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
        """Return the acquisition from a scan, with its processing times."""
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
    """Return template matching without the refinement and the check of its templates."""
    if not isinstance(sensor.acquisition, TemplateMatchingConfig):
        raise TypeError(f"{type(sensor.acquisition).__name__} is no template matching")
    return OnlineTemplateMatching(sensor.acquisition, target, pattern)


def pattern_of(config: LidarConfig) -> ScanPattern:
    """Return the scan pattern of a LIDAR."""
    return ScanPattern.of(config.info())
