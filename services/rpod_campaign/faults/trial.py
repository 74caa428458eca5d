"""A sequence through messages, faults and the whole estimator, in this process.

The sensor's frames become messages, the catalogue's injections change them as in the emulator, and the
estimator reads the result. ``stop`` and ``kill`` affect the estimator itself: its frames are lost, and after
``kill`` it begins anew, without a pose. Faults of links let messages arrive late, or not at all.
"""

from collections.abc import Iterator
from typing import Any, cast

import polars as pl

from rpod_campaign.engine.trial.poses import errors
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.faults.cell import FaultCell
from rpod_campaign.faults.link import Link
from rpod_campaign.pmd.scene import camera_of, scenario_of
from rpod_campaign.sequences.course import EPOCH_S, Course, Shown, lidar_of
from rpod_campaign.sequences.settings import settings_of
from rpod_emulator.faults import Faults, FaultyNode
from rpod_estimator.estimator import Estimator
from rpod_estimator.frame_reader import Arrived, FrameReader
from rpod_pose.navigation.state import Output
from rpod_runtime import BusClock, Node, Received
from rpod_runtime.frames import PartRejectedError
from rpod_runtime.local_node import local_node
from rpod_runtime.sensors import open_publisher
from rpod_schemas.config.emulator import EmulatorConfig, SensorConfig
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.faults import BY_NAME, PlannedFault
from rpod_schemas.messages import NANOSECONDS, write_clock

FRAME = "frame"
"""Column that distinguishes the rows of a sequence."""
SCHEMA: dict[str, Any] = {
    FRAME: pl.Int64,
    "stamp_ns": pl.Int64,
    "mode": pl.Int64,
    "accepted": pl.Boolean,
    "reason": pl.String,
    "attitude_error_deg": pl.Float64,
    "position_error_m": pl.Float64,
    "begin_ns": pl.Int64,
    "end_ns": pl.Int64,
}


class _Sensor:
    """The sensor of a trial: its frames as messages, with the fault."""

    def __init__(self, cell: FaultCell, seed: int, first: Shown) -> None:
        self._sent: list[Received] = []
        self._clock = BusClock()
        self._clock.set(write_clock(round(EPOCH_S * NANOSECONDS)))
        config = _sensor_config(cell)
        emulator = EmulatorConfig(target=cell.target, sensors=(config,), faults=_planned(cell))
        faults = Faults.of(emulator)
        faults.begin(emulator, round(EPOCH_S * NANOSECONDS))
        self._faults, self._name = faults, config.name
        node = FaultyNode(local_node(self._sent.append, self._clock), config, faults, seed=seed)
        self._publisher = open_publisher(
            cast(Node, node), config.kind, config.name, first.measurement.T_chaser_sensor
        )
        self._publisher.announce(config.info())  # type: ignore[attr-defined]

    def announcement(self) -> list[Received]:
        """Return the latched messages."""
        return self._take()

    def messages(self, shown: Shown) -> list[Received]:
        """Return the messages of a frame."""
        stamp_ns = shown.measurement.data.stamp_ns
        self._clock.set(write_clock(stamp_ns))
        if "silence" not in [window.fault.name for window in self._faults.at(self._name, stamp_ns)]:
            self._publisher.publish(shown.measurement.data)
        return self._take()

    def _take(self) -> list[Received]:
        sent = list(self._sent)
        self._sent.clear()
        return sent


def _planned(cell: FaultCell) -> tuple[PlannedFault, ...]:
    if not BY_NAME[cell.fault].of_sensor:
        return ()
    lasts_s = cell.end_s - cell.start_s
    return (PlannedFault(fault=cell.fault, size=cell.size, start_s=cell.start_s, duration_s=lasts_s),)


def _sensor_config(cell: FaultCell) -> SensorConfig:
    if cell.sensor == "lidar":
        return lidar_of(cell.target, cell.document)
    return camera_of(scenario_of(cell.document)).model_copy(update={"name": "pmd"})


def run(cell: FaultCell, seed: int, trial: int) -> list[dict[str, Any]]:
    """Return a row for each result of the estimator."""
    course = Course(cell, seed, trial)
    begin_ns, end_ns = (round((EPOCH_S + time_s) * NANOSECONDS) for time_s in (cell.start_s, cell.end_s))
    rows: list[dict[str, Any]] = []
    for output in _outputs(cell, course, seed, begin_ns, end_ns):
        stamp_ns, found = output.status.stamp_ns, None if output.odometry is None else output.odometry.pose
        truth = course.truth(stamp_ns / NANOSECONDS - EPOCH_S)
        angle_deg, distance_m = errors(truth, found, cached_target(cell.target))
        rows.append(
            {
                FRAME: len(rows),
                "stamp_ns": stamp_ns,
                "mode": int(output.status.mode),
                "accepted": output.status.accepted,
                "reason": output.status.reason,
                "attitude_error_deg": angle_deg,
                "position_error_m": distance_m,
                "begin_ns": begin_ns,
                "end_ns": end_ns,
            }
        )
    return rows


def _outputs(cell: FaultCell, course: Course, seed: int, begin_ns: int, end_ns: int) -> Iterator[Output]:
    settings = settings_of(cell)
    config = EstimatorConfig(target=cell.target, initial_pose=course.truth(0.0), **_fields(settings))
    target = cached_target(cell.target)
    sensor: _Sensor | None = None
    latched: list[Received] = []
    estimator, reader = Estimator(config, target), FrameReader(config.sensors)
    link = Link(cell, begin_ns=begin_ns, end_ns=end_ns, seed=seed)
    fresh = True
    for shown in course.frames():
        if sensor is None:
            sensor = _Sensor(cell, seed, shown)
            latched = sensor.announcement()
        stamp_ns = shown.measurement.stamp_ns
        messages = sensor.messages(shown)
        if cell.fault in ("stop", "kill") and begin_ns <= stamp_ns < end_ns:
            fresh = cell.fault == "stop" and fresh
            continue
        if cell.fault == "kill" and stamp_ns >= end_ns and not fresh:
            unknown = config.model_copy(update={"initial_pose": None})
            estimator, reader, fresh = Estimator(unknown, target), FrameReader(config.sensors), True
            messages = latched + messages
        elif stamp_ns == round(EPOCH_S * NANOSECONDS):
            messages = latched + messages
        if BY_NAME[cell.fault].subject != "link":
            yield from _processed(estimator, reader, messages, stamp_ns)
            continue
        arrivals = link.arrived(stamp_ns)
        link.send(messages, stamp_ns)
        for arrival in [*arrivals, *link.arrived(stamp_ns)]:
            yield from _processed_late(
                estimator, reader, arrival.messages, arrival.time_ns, max_delay_s=config.filter.max_delay_s
            )
        yield from estimator.let_time_pass(stamp_ns)


def _fields(settings: Any) -> dict[str, Any]:
    return {
        name: getattr(settings, name)
        for name in type(settings).model_fields
        if name not in ("target", "initial_pose")
    }


def _processed(
    estimator: Estimator, reader: FrameReader, messages: list[Received], stamp_ns: int
) -> Iterator[Output]:
    """Yield the estimator's results for the messages of a frame, or for the time in which no message came."""
    arrived = list(_arrived(reader, messages))
    estimator.learn(reader.infos)
    for each in arrived:
        yield from estimator.let_time_pass(each.stamp_ns)
        yield estimator.process(each)
        reader.pinned = estimator.pins_setups
    if not arrived:
        yield from estimator.let_time_pass(stamp_ns)


def _processed_late(
    estimator: Estimator, reader: FrameReader, messages: list[Received], now_ns: int, *, max_delay_s: float
) -> Iterator[Output]:
    """Yield the results for messages that arrive at a time; of their frames the newest one is used."""
    arrived = list(_arrived(reader, messages))
    estimator.learn(reader.infos)
    yield from estimator.let_time_pass(now_ns)
    for each in arrived[-1:]:
        age_s = (now_ns - each.stamp_ns) / NANOSECONDS
        if age_s > max_delay_s:
            late = MessageRejectedError(
                Reason.LATE, f"{age_s:.3f} s old, filter.max_delay_s is {max_delay_s:g}"
            )
            yield estimator.process(Arrived.unusable(each.sensor, each.stamp_ns, late))
            continue
        yield estimator.process(each)
        reader.pinned = estimator.pins_setups


def _arrived(reader: FrameReader, messages: list[Received]) -> Iterator[Arrived]:
    for received in messages:
        try:
            if received.topic.name not in reader.parts:
                reader.learn(received)
                continue
            sensor, part = reader.parts[received.topic.name]
            stamp_ns = reader.stamp_ns(sensor, received)
            for frame in reader.assemblers[sensor].add(part, stamp_ns, received):
                try:
                    yield reader.arrived(sensor, frame, 0.0)
                except PartRejectedError as error:
                    yield Arrived.unusable(sensor, frame.stamp_ns, error)
        except MessageRejectedError:
            continue
