"""Creation of the methods by which a sensor acquires and tracks the target, from its configuration."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from rpod_pose.joints.methods import RigidMethods, jointed
from rpod_pose.ports import KindMethods, Methods, Task, Tracker
from rpod_pose.unreliable import UnreliableParts, ignoring
from rpod_schemas.config.sensor import SensorInput
from rpod_schemas.poses import make_pose
from rpod_schemas.registry import resolve
from rpod_schemas.sensors import sensor_kind
from rpod_target import Target, posed


def kind_methods(sensor: SensorInput) -> KindMethods:
    """Return the functions that create the methods of a sensor's kind; their modules are imported."""
    made: KindMethods = resolve(sensor_kind(sensor.kind).methods)
    return made


def methods_of(sensor: SensorInput, target: Target, setup: Any = ()) -> Methods:
    """Return the methods for a sensor, which ignore unreliable parts and find the angles of joints.

    Args:
        sensor: configuration of the sensor.
        target: the target to find.
        setup: result of ``KindMethods.setup`` of its kind, for example a LIDAR's scan pattern.
    """
    kind = kind_methods(sensor)
    if target.joints and kind.tracker is not None and kind.points is not None:
        rigid = _rigid(sensor, setup, kind.tracker, kind.points)
        return jointed(target, replace(rigid, comparable=kind.comparable))
    if target.joints:  # their parts are ignored
        target = replace(posed(target, {}), reliable=target.fixed)
    whole = kind.make(Task(target, sensor, setup))
    if target.reliable is None or kind.masked is None:
        return whole
    reliable = kind.make(Task(target.reliable, sensor, setup))
    return ignoring(reliable, whole, UnreliableParts(target, target.reliable), kind.masked)


def _rigid(
    sensor: SensorInput,
    setup: Any,
    make_tracker: Callable[[Task], Tracker[Any]],
    points: Callable[[Any], Any],
) -> RigidMethods:
    """Return the functions that create a sensor's methods for a rigid target."""

    def methods(target: Target) -> Methods:
        return methods_of(sensor, target, setup)

    def tracker(target: Target) -> Tracker[Any]:
        if target.reliable is not None:
            return methods(target).tracker
        return make_tracker(Task(target, sensor, setup))

    return RigidMethods(methods, tracker, points)


def warm_up(sensor: SensorInput, methods: Methods, target: Target, setup: Any = ()) -> None:
    """Run the methods on ideal frames, so that compiled code is loaded before the first frame."""
    T_sensor_target = make_pose(translation_m=[0.0, 0.0, 3.0 * target.radius_m + 1.0])
    frames = kind_methods(sensor).frames(target, T_sensor_target, setup)
    methods.acquirer.acquire(frames[0])
    for frame in frames:
        methods.tracker.track(frame, T_sensor_target)


def ready_methods(sensor: SensorInput, target: Target, setup: Any = ()) -> Methods:
    """Return the methods for a sensor, warmed up; arguments as for ``methods_of``."""
    methods = methods_of(sensor, target, setup)
    warm_up(sensor, methods, target, setup)
    return methods
