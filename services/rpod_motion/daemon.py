"""The motion service: publishes the truth, by the wall clock or in lockstep."""

import logging
import time
from threading import Event

from rpod_motion.errors import MotionError
from rpod_motion.imu import Imu
from rpod_motion.lockstep import Lockstep
from rpod_motion.motion import Motion, build_motion
from rpod_motion.thrust import Thrusters
from rpod_motion.truth import TruthPublisher
from rpod_motion.truth_error import TruthError
from rpod_runtime import Node
from rpod_runtime.bus.link import utc
from rpod_runtime.errors import RefusedError
from rpod_runtime.process.notify import manager
from rpod_runtime.requests.sole import Sole
from rpod_runtime.ros import trigger
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import MotionServiceConfig
from rpod_schemas.control import Accepted, StartRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.topics import TRUTH
from rpod_schemas.types import Health
from rpod_target import load_target

log = logging.getLogger(__name__)

_SPARE_S = 0.2
"""Time between the start and the epoch if no epoch is given; longer than the truth before the epoch."""
_TAIL_S = 0.1
"""Duration of truth after the end, so that exposures at the end are covered."""
_LONGEST_TAIL_S = 0.9
"""Longest duration of truth after the end in lockstep; the motion is defined a little longer than that."""

_LONGEST_WAIT_S = 1.0
_TOGETHER = 0.5
"""Share of the lead over which ticks are published together. Each message wakes a thread in the router and in
each receiver, which takes longer than to read it."""
_OVERDUE_S = 1.0
"""Longest span of truth that is published at once after a late start; receivers keep 2 s or more of it."""


def run(config: MotionServiceConfig, *, version: str, stop: Event) -> None:
    """Publish the scenario's truth from start to end, then return.

    Raises:
        ConfigurationError: the configured motion is not possible.
        LockstepError: in lockstep, a service did not answer in time.
    """
    target = load_target(config.target)
    try:
        motion = build_motion(
            config.motion,
            centre_of_mass_m=target.centre_of_mass_m,
            inertia_kg_m2=target.inertia_kg_m2,
            duration_s=config.duration_s,
        )
    except MotionError as error:
        raise ConfigurationError(config.instance, "motion", str(error)) from error
    with Node(config, version=version, stop=stop, sole=Sole((TRUTH,))) as node:
        epoch_ns = _epoch(node, config)
        if epoch_ns is None:
            return
        truth = _truth(node, motion, config, epoch_ns, target.centre_of_mass_m)
        first, last = truth.tick(-config.preroll_s), truth.tick(config.duration_s + _tail_s(config))
        node.state = "running"
        node.health.report(Health.OK, f"playing {config.duration_s:g} s, begun at {utc(epoch_ns)}")
        if config.speed == "max":
            Lockstep(node, config, truth).play(first, last)
        else:
            first = max(first, _present(truth, first))
            _play_by_the_wall(node, truth, range(first, last + 1), lead_s=config.lead_s)
        if node.stop.is_set():
            return
        node.state = "finished"
        node.health.report(Health.OK, "finished")
        log.info("finished after %g s of scenario time", config.duration_s)
        if config.await_start:
            manager.attend(node.stop)  # the process that started it asks for its state, then stops it


def _truth(
    node: Node, motion: Motion, config: MotionServiceConfig, epoch_ns: int, centre_of_mass_m: FloatArray
) -> TruthPublisher:
    error = imu = thrusters = None
    if config.truth_error is not None:
        error = TruthError(config.truth_error, seed=config.seed, rate_hz=config.rate_hz)
    if config.motion.imu is not None:
        imu = Imu(config.motion.imu, motion, centre_of_mass_m=centre_of_mass_m, seed=config.seed)
    if config.motion.command is not None:
        drawn = config.motion.command
        thrusters = Thrusters(drawn, motion, centre_of_mass_m=centre_of_mass_m, seed=config.seed)
    return TruthPublisher(
        node,
        motion,
        epoch_ns=epoch_ns,
        rate_hz=config.rate_hz,
        error=error,
        imu=imu,
        thrusters=thrusters,
        bodies=config.motion.bodies,
    )


def _tail_s(config: MotionServiceConfig) -> float:
    """Return the duration of truth after the end."""
    if config.speed != "max":
        return _TAIL_S
    latest_s = max((sensor.latency_s for sensor in config.sensors), default=0.0)
    return min(max(_TAIL_S, latest_s + 1.0 / config.rate_hz), _LONGEST_TAIL_S)


def _epoch(node: Node, config: MotionServiceConfig) -> int | None:
    """Wait for the start and return the epoch; None if the service is stopped before."""
    if not config.await_start:
        anew = "" if config.epoch_ns else ", from the beginning: with epoch_ns a restart goes on"
        node.ready(f"playing at once{anew}")
        return _epoch_ns(config)
    started = Event()
    requests: list[StartRequest] = []

    def start(request: StartRequest) -> Accepted:
        if requests:
            raise RefusedError(
                "already started; a motion service plays once, start another one for the next run"
            )
        requests.append(request)
        started.set()
        return Accepted()

    node.serve("start", StartRequest, start, ros=trigger(StartRequest))
    node.ready("waiting for the start query")
    while not started.wait(0.05):
        manager.alive()
        if node.stop.is_set():
            return None
    return requests[0].epoch_ns or _epoch_ns(config)


def _epoch_ns(config: MotionServiceConfig) -> int:
    """Return the configured epoch, or one as soon as possible."""
    return config.epoch_ns or time.time_ns() + round(_SPARE_S * NANOSECONDS)


def _present(truth: TruthPublisher, first: int) -> int:
    """Return the tick of now if the first one is long overdue: after a restart the motion goes on."""
    now_s = (time.time_ns() - truth.stamp_ns(0)) / NANOSECONDS
    if (truth.stamp_ns(first) - truth.stamp_ns(0)) / NANOSECONDS > now_s - _OVERDUE_S:
        return first
    log.warning("the epoch was %.1f s ago: the motion goes on with the state of the present time", now_s)
    return truth.tick(now_s)


def _play_by_the_wall(node: Node, truth: TruthPublisher, ticks: range, *, lead_s: float) -> None:
    """Publish each tick at most ``lead_s`` before its time; overdue ticks follow without a pause."""
    period_s = (truth.stamp_ns(1) - truth.stamp_ns(0)) / NANOSECONDS
    together = 1 + int(_TOGETHER * lead_s / period_s)
    for first in range(0, len(ticks), together):
        group = ticks[first : first + together]
        if not _awaited(node.stop, truth.stamp_ns(group[-1]), lead_s=lead_s):
            return
        for tick in group:
            truth.publish(tick)
    node.stop.wait(lead_s)


def _awaited(stop: Event, stamp_ns: int, *, lead_s: float) -> bool:
    """Wait until ``lead_s`` before a stamp; return False if the service is stopped."""
    manager.alive()
    while (wait_s := (stamp_ns - time.time_ns()) / NANOSECONDS - lead_s) > 0:
        if stop.wait(min(wait_s, _LONGEST_WAIT_S)):
            return False
        manager.alive()
    return not stop.is_set()
