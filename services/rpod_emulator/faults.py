"""Faults of the emulated sensors: when they hold, and a node between a sensor's publisher and the bus.

What a fault does to messages is in ``rpod_sim_sensor.faults``. Messages that a fault delays wait here.
"""

import copy
import heapq
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any, Self

from scipy.spatial.transform import RigidTransform, Rotation

from rpod_runtime import Node
from rpod_runtime.delivery.publisher import Publisher
from rpod_runtime.errors import RefusedError
from rpod_schemas.config.emulator import EmulatorConfig, SensorConfig
from rpod_schemas.control import FaultRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.faults import AskedFault, Fault
from rpod_schemas.faults.injected import InjectedFault
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import chained, make_pose
from rpod_schemas.topics import Topic
from rpod_sim_sensor.faults import Injection, Outgoing, injection, parts_of

_ALWAYS_NS = 2**62
_MOST_REQUESTED = 500
"""Largest number of requested faults that are remembered, those that are over included."""
_INJECTOR = {"link": "the proxy", "process": "the supervisor of a run", "disk": "the logger"}


@dataclass(frozen=True)
class Window:
    """One fault with its sensor, its start and its end."""

    fault: Fault
    sensor: str | None
    """Name of the sensor; None for all."""
    start_ns: int
    end_ns: int
    size: float | None = None
    """Size in the catalogue's unit; None if it has none, or if it is drawn."""

    def injected(self, epoch_ns: int) -> InjectedFault:
        """Return the fault as the bus reports it; one that exists from the start begins with the scenario."""
        return InjectedFault(
            fault=self.fault.name,
            where=self.sensor or "",
            begin_ns=max(self.start_ns, epoch_ns),
            end_ns=None if self.end_ns == _ALWAYS_NS else self.end_ns,
            size=self.size,
        )


@dataclass
class Faults:
    """The faults that were configured or requested."""

    in_lockstep: bool = False
    sensors: Mapping[str, str] = field(default_factory=dict)
    """Kinds of the sensors, by name."""
    run: int = 0
    """Number of runs that have begun."""
    _planned: list[Window] = field(default_factory=list)
    _requested: list[Window] = field(default_factory=list)

    @classmethod
    def of(cls, config: EmulatorConfig) -> Self:
        """Return the configured faults; raise ``ConfigurationError`` if one cannot be injected."""
        sensors = {sensor.name: sensor.kind for sensor in config.sensors}
        self = cls(config.in_lockstep, sensors)
        for number, planned in enumerate(config.faults):
            try:
                self._check(planned, at_start=not planned.start_s)
            except RefusedError as error:
                raise ConfigurationError(config.instance, f"faults.{number}", str(error)) from error
        self.begin(config, None)
        return self

    def begin(self, config: EmulatorConfig, epoch_ns: int | None) -> None:
        """Plan the configured faults from the scenario's epoch; without one, those of the start only.

        In lockstep, where times repeat, those that were requested in a run before are over.
        """
        self._planned = []
        if self.in_lockstep:
            self._requested = []
        self.run += 1
        for planned in config.faults:
            if planned.start_s and epoch_ns is None:
                continue
            start_ns = (epoch_ns or 0) + round(planned.start_s * NANOSECONDS) if planned.start_s else 0
            lasts = epoch_ns is not None and planned.duration_s is not None
            end_s = planned.start_s + (planned.duration_s or 0.0)
            end_ns = (epoch_ns or 0) + round(end_s * NANOSECONDS) if lasts else _ALWAYS_NS
            self._planned.append(Window(planned.kind, planned.sensor, start_ns, end_ns, planned.amount))

    def request(self, request: FaultRequest, now_ns: int) -> None:
        """Plan a fault from the time of the newest truth on, below 0 if none has come.

        Raises:
            RefusedError: the fault cannot be injected, or there is no time from which it could count.
        """
        self._check(request, at_start=False)
        if now_ns < 0:
            raise RefusedError("no truth has come, from which the fault's time counts: start motion first")
        if len(self._requested) >= _MOST_REQUESTED:
            self._requested = [window for window in self._requested if window.end_ns > now_ns]
        if len(self._requested) >= _MOST_REQUESTED:
            raise RefusedError(f"{_MOST_REQUESTED} faults are planned or active already; wait for their end")
        start_ns = now_ns + round(request.start_s * NANOSECONDS)
        end_ns = start_ns + round(request.duration_s * NANOSECONDS)
        self._requested.append(Window(request.kind, request.sensor, start_ns, end_ns, request.amount))

    def _check(self, asked: AskedFault, *, at_start: bool) -> None:
        fault, sensor = asked.kind, asked.sensor
        if not fault.of_sensor:
            raise RefusedError(f"{fault.name} is no fault of a sensor: {_INJECTOR[fault.subject]} injects it")
        if not any(sensor in (None, name) and fault.can_be_in(kind) for name, kind in self.sensors.items()):
            known = ", ".join(f"{name} ({kind})" for name, kind in self.sensors.items())
            raise RefusedError(f"no sensor {sensor or ''} can have the fault {fault.name}; there are {known}")
        if self.in_lockstep and not fault.in_lockstep:
            raise RefusedError(
                f"lockstep waits for every frame under its own stamp, not so with {fault.name}: ask for "
                "a blackout instead, or run with --speed 1"
            )
        if fault.from_start and not at_start:
            raise RefusedError(f"{fault.name} cannot begin while a sensor runs: configure it with start_s 0")

    def at(self, sensor: str, stamp_ns: int) -> list[Window]:
        """Return the faults of a sensor at a stamp, in the order in which they were asked for."""
        return [
            window
            for window in (*self._planned, *self._requested)
            if window.sensor in (None, sensor) and window.start_ns <= stamp_ns < window.end_ns
        ]

    def begun(self, stamp_ns: int, epoch_ns: int) -> list[InjectedFault]:
        """Return the faults that began up to a stamp, in the order of their beginning."""
        begun = [each.injected(epoch_ns) for each in (*self._planned, *self._requested)]
        return sorted(
            (each for each in begun if each.begin_ns <= stamp_ns), key=lambda each: each.identity[::-1]
        )


def turned(T_sensor_target: RigidTransform, active: Sequence[Window]) -> RigidTransform:
    """Return the pose at which the target is shown: turned about its x axis by the faults of the scene."""
    angle_deg = sum(window.size or 0.0 for window in active if window.fault.name == "half_turn")
    if not angle_deg:
        return T_sensor_target
    return chained(T_sensor_target, make_pose(rotation=Rotation.from_euler("x", angle_deg, degrees=True)))


class FaultyNode:
    """A node for one sensor whose publishers pass each message through the sensor's faults.

    Everything else is the node's.
    """

    def __init__(self, node: Node, sensor: SensorConfig, faults: Faults, *, seed: int) -> None:
        self._node, self._faults, self._seed = node, faults, seed
        self._name, self._kind = sensor.name, sensor.kind
        self._parts = parts_of(sensor.kind, sensor.name)
        self._publishers: dict[tuple[Topic, str], Publisher] = {}
        self._announced: dict[str, tuple[Topic, Any, Sequence[str]]] = {}
        self._waiting: list[tuple[float, int, int, Outgoing]] = []
        self._due_s: dict[str, float] = {}
        self._numbers = count()
        self._run, self._newest_ns = faults.run, 0
        self._injections: dict[tuple[str, int], Injection] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)

    def publisher(self, topic: Topic) -> "FaultyPublisher":
        """Return a publisher of this sensor."""
        return FaultyPublisher(self, topic)

    def put(self, topic: Topic, message: Any) -> None:
        """Publish a message, or what the faults make of it."""
        outgoing = Outgoing(topic, self._parts.get(topic.name, "extra"), message)
        active = self._active(0 if outgoing.latched else outgoing.stamp_ns)
        waits = self._due_s.get(topic.name, 0.0) > time.monotonic()
        if active or waits:  # it may be kept, and the sensor uses its arrays again
            outgoing = replace(outgoing, message=copy.deepcopy(message))
        if outgoing.latched:
            self._announced[topic.name] = topic, message, [each.fault for each in active]
        else:
            self._announce(active)
        self._send(outgoing, active)

    def _active(self, stamp_ns: int = 0) -> list[Injection]:
        if self._run != self._faults.run:  # the times may be those of the run before
            self._run, self._newest_ns, self._injections = self._faults.run, 0, {}
        self._newest_ns = max(self._newest_ns, stamp_ns)
        windows = {
            window.fault.name: window
            for window in self._faults.at(self._name, self._newest_ns)
            if window.fault.subject == "messages" and window.fault.can_be_in(self._kind)
        }
        before, self._injections = self._injections, {}
        for name, window in windows.items():
            key = name, window.start_ns
            self._injections[key] = before.get(key) or injection(
                name, self._kind, self._seed, sensor=self._name, size=window.size
            )
        return list(self._injections.values())

    def _send(self, outgoing: Outgoing, active: list[Injection]) -> None:
        several = [outgoing]
        for each in active:
            several = [made for one in several for made in each.apply(one)]
        for made in several:
            # As in the queue of a link, no message overtakes another one of its topic.
            due_s = max(time.monotonic() + made.delay_s, self._due_s.get(made.topic.name, 0.0))
            if made.delay_s > 0.0 or due_s > time.monotonic():
                self._due_s[made.topic.name] = due_s
                heapq.heappush(self._waiting, (due_s, next(self._numbers), time.time_ns(), made))
            else:
                self._publish(made)

    def _publish(self, outgoing: Outgoing, since_ns: int | None = None) -> None:
        place = outgoing.topic, outgoing.publisher
        if place not in self._publishers:
            self._publishers[place] = self._node.publisher(outgoing.topic)
        if outgoing.lost:
            self._publishers[place].lose()
        else:
            self._publishers[place].publish(outgoing.message, since_ns=since_ns)

    def refresh(self) -> None:
        """Publish delayed messages that are due; announce the sensor anew where its faults have changed."""
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, _, since_ns, outgoing = heapq.heappop(self._waiting)
            self._publish(outgoing, since_ns)
        self._announce(self._active())

    def _announce(self, active: list[Injection]) -> None:
        names = [each.fault for each in active]
        for topic, message, before in list(self._announced.values()):
            if names != before and (set(names) ^ set(before)):
                self._announced[topic.name] = topic, message, names
                self._send(Outgoing(topic, self._parts[topic.name], message), active)


@dataclass(frozen=True)
class FaultyPublisher:
    """A publisher of one topic of a ``FaultyNode``."""

    node: FaultyNode
    topic: Topic

    def publish(self, message: Any) -> None:
        """Publish a message, or what the faults make of it."""
        self.node.put(self.topic, message)
