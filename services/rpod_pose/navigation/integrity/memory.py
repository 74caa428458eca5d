"""Memory of the integrity monitor from one frame to the next."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.integrity.frame_evidence import FrameEvidence
from rpod_pose.navigation.integrity.past import Past
from rpod_pose.navigation.integrity.residuals import Residual, recent
from rpod_pose.navigation.integrity.sizes import SizedFilters
from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Memory:
    """State of the monitor between two frames."""

    residuals: Mapping[str, tuple[Residual, ...]] = field(default_factory=dict)
    """Residuals of each sensor in the window."""
    without: Mapping[str, FilterState] = field(default_factory=dict)
    """Filters without one of several sensors, by that sensor's name."""
    sized: SizedFilters = field(default_factory=dict)
    """Filters of the poses for other sizes of the target; none if several sensors support the track."""
    past: Past = field(default_factory=Past)
    """Where the estimate was before."""
    sensor: str = ""
    """Sensor whose measurement was accepted last."""
    frozen_ns: Mapping[str, int] = field(default_factory=dict)
    """Stamp of the newest frame of each sensor that sends identical frames."""
    frames: FrameEvidence = field(default_factory=FrameEvidence)
    """Evidence in the sensors' own frames that the model or a part of the data is wrong."""
    mounts: Mapping[str, RigidTransform] = field(default_factory=dict)
    """Mounts T_chaser_sensor of the sensors, by name."""

    def with_residual(self, sensor: str, residual: Residual, window_s: float) -> "Memory":
        """Return the memory with one more residual of a sensor, without those older than a window, s."""
        residuals = {**self.residuals, sensor: (*self.residuals.get(sensor, ()), residual)}
        newest_ns = max(each[-1].stamp_ns for each in residuals.values())
        kept = {name: recent(each, newest_ns, window_s) for name, each in residuals.items()}
        return replace(self, residuals={name: each for name, each in kept.items() if each})

    def place_m(self, estimate: FilterState) -> FloatArray:
        """Return the target's position relative to the farthest sensor, chaser axes, shape (3,), m."""
        place_m = estimate.T_chaser_target.translation
        seen_m = (place_m - mount.translation for mount in self.mounts.values())
        return max(seen_m, key=np.linalg.norm, default=place_m)
