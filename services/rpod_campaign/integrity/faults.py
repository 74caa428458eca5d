"""Kinds of faults, each with a sweep of sizes, and what a fault does to a measurement.

``clock_behind`` is a clock that is set back during the sequence, ``clock_off`` one that was behind before it.
Where the catalogue of sensor faults knows a kind (``frozen``, ``clock_behind``, ``mount_off``), it has the
same name here. These faults act on a frame in the process, between the emulated sensor and the navigator.
"""

from dataclasses import dataclass, replace
from math import log

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.integrity.ranges import with_longer_ranges
from rpod_pose.measurement import Measurement
from rpod_pose.ports import Registration, Tracker
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import make_pose
from rpod_schemas.types import SensorFrame


@dataclass(frozen=True)
class Fault:
    """A kind of fault."""

    name: str
    sizes: tuple[float, ...]
    unit: str
    lasting: bool = False
    """Whether the fault exists from the first frame on."""
    seen_by_one: bool = True
    """Whether a sensor alone can detect the fault; if not, the levels contain a declared sigma for it."""


FAULTS = (
    Fault("none", (0.0,), "", lasting=True),
    Fault("half_turn", (10.0, 45.0, 180.0), "deg"),
    Fault("wrong_target", (1.0, 2.0, 3.0), "kind", lasting=True),
    Fault("wrong_scale", (1.0, 2.0, 3.0, 10.0), "%", lasting=True),
    Fault("mount_off", (0.1, 0.3, 1.0, 3.0), "deg", seen_by_one=False),
    Fault("clock_behind", (0.01, 0.05, 0.2), "s", seen_by_one=False),
    Fault("clock_off", (0.05,), "s", lasting=True, seen_by_one=False),
    Fault("frozen", (0.5, 2.0), "s"),
    Fault("range_drift", (2.0, 10.0, 50.0), "mm/s", seen_by_one=False),
)
"""All kinds, with their sizes."""
BY_NAME = {fault.name: fault for fault in FAULTS}
FAULT_NAMES = tuple(BY_NAME)
PARTS_OF = {"hexagonal-body": "mockup"}
"""Model that is looked for in ``wrong_target`` of kind 1, by the target; ``hexagonal-body`` for all others.
It is the body of the mock-up, whose front it lacks."""
OTHERS = ("random-report-7-2-small", "random-report-7-3")
"""Bodies of which one is looked for in ``wrong_target`` of kind 2, as large as the target."""
_LEAST_SCALE, _MOST_SCALE = 0.51, 1.99
"""Limits of the scale of a model that a variation allows (``rpod_target.variation``)."""


def model_of(target: str, fault: str, size: float) -> str:
    """Return the name of the model that the methods look for.

    A wrong target has one of three kinds: 1, a body that is a part of the mock-up; 2, another body, as large
    as the target; 3, the target with places off by a tenth of its radius (RMS).
    """
    if fault == "wrong_scale":
        return f"{target}@scale={size:g}%"
    if fault != "wrong_target":
        return target
    if size == 1.0:
        return PARTS_OF.get(target, "hexagonal-body")
    radius_m = cached_target(target).radius_m
    if size == 3.0:
        return f"{target}@off={100.0 * radius_m:.0f}mm"
    scales = {name: radius_m / cached_target(name).radius_m for name in OTHERS}
    name = min(scales, key=lambda each: abs(log(scales[each])))
    scale = min(max(scales[name], _LEAST_SCALE), _MOST_SCALE)
    return f"{name}@scale={100.0 * (scale - 1.0):.0f}%"


class Injector:
    """Gives the measurements of one sensor a fault from a time on.

    Args:
        fault: name of the fault.
        size: its size, in its unit.
        start_s: time of the sequence at which it begins; a frozen stream lasts for ``size``.
    """

    def __init__(self, fault: str, size: float, *, start_s: float) -> None:
        self._fault, self._size, self._start_s = fault, size, start_s
        self._last: SensorFrame | None = None
        self.repeats = 0
        """Number of frames in a row, up to the newest, that equal the frame before."""

    def is_active(self, time_s: float) -> bool:
        """Return whether the fault is there at a time."""
        if self._fault == "none" or time_s < self._start_s:
            return False
        return self._fault != "frozen" or time_s < self._start_s + self._size

    def measured(self, time_s: float, measurement: Measurement) -> Measurement:
        """Return the measurement with the fault, if it is there at a time."""
        self.repeats = self.repeats + 1 if self.is_active(time_s) and self._fault == "frozen" else 0
        if not self.is_active(time_s):
            self._last = measurement.data
            return measurement
        data, mount = measurement.data, measurement.T_chaser_sensor
        if self._fault == "mount_off":
            turn = make_pose(rotation=Rotation.from_rotvec([0.0, np.deg2rad(self._size), 0.0]))
            return replace(measurement, T_chaser_sensor=mount * turn)
        if self._fault in ("clock_behind", "clock_off"):
            stamp_ns = data.stamp_ns - round(self._size * NANOSECONDS)
            return replace(measurement, data=data.model_copy(update={"stamp_ns": stamp_ns}))
        if self._fault == "frozen" and self._last is not None:
            return replace(measurement, data=self._last.model_copy(update={"stamp_ns": data.stamp_ns}))
        if self._fault == "range_drift":
            longer_m = 1e-3 * self._size * (time_s - self._start_s)
            return replace(measurement, data=with_longer_ranges(data, longer_m=longer_m))
        return measurement


class TurnedTracker:
    """A tracker that accepts the true pose turned by an angle, as it would accept a flipped pose.

    Args:
        tracker: the tracker that measures.
        turn: turn of the target in its own axes.
    """

    def __init__(self, tracker: Tracker[SensorFrame], turn: Rotation) -> None:
        self._tracker, self._turn = tracker, make_pose(rotation=turn)
        self.truth: RigidTransform | None = None
        """True pose, whose registration is turned; None while the result is not changed."""

    def track(self, measurement: SensorFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration, turned while the true pose is given."""
        if self.truth is None:
            return self._tracker.track(measurement, T_sensor_target)
        found = self._tracker.track(measurement, self.truth)
        if found.T_sensor_target is None:
            return found
        return replace(found, T_sensor_target=found.T_sensor_target * self._turn)
