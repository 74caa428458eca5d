"""Memory of the integrity monitor from one frame to the next."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.navigation.filter import FilterState, predict
from rpod_pose.navigation.integrity.clock_frames import Apart, TwoClocks
from rpod_pose.navigation.integrity.frame_evidence import FrameEvidence
from rpod_pose.navigation.integrity.past import Past
from rpod_pose.navigation.integrity.residuals import Residual, recent
from rpod_pose.navigation.integrity.sizes import SizedFilters
from rpod_pose.navigation.integrity.wrong_streams import WrongStreams
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.messages import NANOSECONDS


@dataclass(frozen=True, eq=False)
class Memory:
    """State of the monitor between two frames."""

    residuals: Mapping[str, tuple[Residual, ...]] = field(default_factory=dict)
    """Residuals of each sensor in the window."""
    without: Mapping[str, FilterState] = field(default_factory=dict)
    """Filters without one of several sensors, by that sensor's name."""
    former: Mapping[str, tuple[FilterState, ...]] = field(default_factory=dict)
    """The same filters after each of the last measurements, oldest first."""
    apart: Mapping[str, tuple[Apart, ...]] = field(default_factory=dict)
    """Frames of the slower of two sensors, by its name, beside the track of the other."""
    clocks: TwoClocks | None = None
    """What two sensors tell of their clocks, or have told last."""
    sized: SizedFilters = field(default_factory=dict)
    """Filters of the poses for other sizes of the target; none if several sensors support the track."""
    past: Past = field(default_factory=Past)
    """Where the estimate was before."""
    sensor: str = ""
    """Sensor whose measurement was accepted last."""
    wrong: WrongStreams = field(default_factory=WrongStreams)
    """Sensors whose stream is frozen, or whose clock was set."""
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

    def without_at(self, stamp_ns: int, config: FilterConfig) -> dict[str, FilterState]:
        """Return the filters without one of several sensors at a stamp, but those that are newer."""
        there = {name: each for name, each in self.without.items() if each.stamp_ns <= stamp_ns}
        return {name: predict(each, stamp_ns, config) for name, each in there.items()}

    def with_filters(self, without: Mapping[str, FilterState], delay_s: float) -> "Memory":
        """Return the memory with the filters without one sensor, and their states of the last time, s."""
        former = {}
        for name, newest in without.items():
            oldest_ns = newest.stamp_ns - round(delay_s * NANOSECONDS)
            kept = (x for x in self.former.get(name, ()) if oldest_ns <= x.stamp_ns < newest.stamp_ns)
            former[name] = (*kept, newest)
        return replace(self, without=without, former=former)

    def former_at(self, sensor: str, stamp_ns: int) -> tuple[FilterState, FilterState] | None:
        """Return the filter without a sensor as it was at a stamp, and as long before as it is known.

        None if the filter at the stamp is not known any more.
        """
        before = [x for x in self.former.get(sensor, ()) if x.stamp_ns <= stamp_ns]
        return (before[-1], before[0]) if before else None

    @property
    def slow(self) -> str:
        """Name of that of two sensors which has fewer frames in the window; empty for any other number."""
        if len(self.residuals) != 2:
            return ""
        return min(sorted(self.residuals), key=lambda name: len(self.residuals[name]))

    def with_apart(self, sensor: str, apart: Apart | None, memory_s: float) -> "Memory":
        """Return the memory with one more frame of the slower sensor, without those older than a time, s."""
        if apart is None:
            return self
        frames = (*self.apart.get(sensor, ()), apart)
        newest_ns = max(each.stamp_ns for each in frames)
        kept = (each for each in frames if newest_ns - each.stamp_ns <= memory_s * NANOSECONDS)
        return replace(self, apart={sensor: tuple(sorted(kept, key=lambda each: each.stamp_ns))})

    def clocks_at(self, stamp_ns: int, memory_s: float) -> TwoClocks | None:
        """Return what two sensors have told of their clocks within a time, s; None for nothing."""
        if self.clocks is None or stamp_ns - self.clocks.stamp_ns > memory_s * NANOSECONDS:
            return None
        return self.clocks

    def place_m(self, estimate: FilterState) -> FloatArray:
        """Return the target's position relative to the farthest sensor, chaser axes, shape (3,), m."""
        place_m = estimate.T_chaser_target.translation
        seen_m = (place_m - mount.translation for mount in self.mounts.values())
        return max(seen_m, key=np.linalg.norm, default=place_m)
