"""The estimator daemon, which connects the estimator to the bus and the clock."""

import logging
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from threading import Event
from typing import Any

from rpod_estimator.ahead import Held
from rpod_estimator.estimator import TICK_S, Estimator, Unjudged, check_reset
from rpod_estimator.frame_reader import Arrived
from rpod_estimator.inputs.bodies import BodyInput, BodyReport
from rpod_estimator.inputs.command import CommandInput
from rpod_estimator.inputs.imu import ImuInput
from rpod_estimator.inputs.stamped import StampedInput
from rpod_estimator.inputs.subscriptions import Subscriptions
from rpod_estimator.judging import Judging
from rpod_estimator.live_searches import LiveSearches, Worker
from rpod_estimator.outputs import Outputs
from rpod_estimator.search_process import Loaded, SearchProcess, native_threads
from rpod_estimator.validity import Beacon, Validity
from rpod_pose.navigation.first_pose.searches import Searches
from rpod_pose.navigation.state import Output
from rpod_pose.ports import Methods
from rpod_runtime import Node
from rpod_runtime.process.notify import manager
from rpod_runtime.process.standing import StandWatch
from rpod_runtime.requests.sole import Sole
from rpod_runtime.ros import RESET_SERVICE
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.control import Accepted, ResetRequest
from rpod_schemas.topics import STATUS
from rpod_schemas.types import Mode
from rpod_target import Target, load_target

log = logging.getLogger(__name__)


def run(config: EstimatorConfig, *, version: str, stop: Event) -> None:
    """Run the estimator until ``stop`` is set."""
    log.info(
        "loading the target %s and the methods; the first start compiles, which takes longer", config.target
    )
    threads = native_threads()
    with ExitStack() as stack:
        target = load_target(config.target)
        workers: dict[str, Worker] = {}
        live = LiveSearches(workers)

        def open_searches(methods: Mapping[str, Methods], setups: Mapping[str, Any]) -> Searches:
            may_fork = threads is not None and native_threads() == threads
            for sensor in config.sensors:
                name = sensor.name
                loaded = Loaded(target, methods.get(name), setups.get(name)) if may_fork else None
                workers[name] = SearchProcess(config.target, sensor, loaded)
                stack.callback(workers[name].end)
            return live.of(methods, setups)

        # in lockstep, results must not depend on the machine's speed
        estimator = Estimator(config, target, None if config.in_lockstep else open_searches)
        live.await_workers(stop)
        _serve(config, estimator, live, target, version=version, stop=stop)


def _serve(
    config: EstimatorConfig,
    estimator: Estimator,
    live: LiveSearches,
    target: Target,
    *,
    version: str,
    stop: Event,
) -> None:
    sole = Sole((STATUS.under(config.prefix),))
    with Node(config, version=version, stop=stop, sole=sole) as node, StandWatch() as stands:
        node.target_digest, node.target_content = target.digest, target.content_digest
        subscriptions, outputs = Subscriptions(node, config, stands), Outputs(node, config.prefix, target)
        readings = (
            ImuInput(node, config, estimator.imu),
            CommandInput(node, config, estimator.commands),
            BodyInput(node, config, estimator.bodies),
        )
        bodies = BodyReport(node, estimator.bodies)
        with (
            Beacon(Validity(config.stale_after_s), outputs.publish_validity, node.clock) as beacon,
            Judging(at_once=config.in_lockstep or estimator.uses_readings) as judging,
            Held(config.filter.max_delay_s, subscriptions.wake) as held,
        ):
            service = _Service(
                estimator,
                subscriptions,
                outputs,
                beacon,
                searches=live,
                readings=readings,
                judging=judging,
                held=held,
                in_lockstep=config.in_lockstep,
            )
            node.serve("reset", ResetRequest, service.reset, ros=RESET_SERVICE)
            node.ready(f"listening to {', '.join(sensor.name for sensor in config.sensors)}")
            while not stop.is_set():
                manager.alive()
                subscriptions.pin(estimator.pins_setups)
                arrived = subscriptions.newest(TICK_S)
                estimator.learn(subscriptions.infos)
                if arrived is not None:
                    service.take(arrived)
                service.take_held()
                service.tick(node.clock.settled_ns())
                bodies.update()
                subscriptions.report_health(estimator.mode)
            service.take_rest(subscriptions.rest())  # each frame gets a status, or is counted as dropped
            bodies.update()


class _Service:
    """The estimator with the publishers of its results."""

    def __init__(
        self,
        estimator: Estimator,
        subscriptions: Subscriptions,
        outputs: Outputs,
        beacon: Beacon,
        *,
        searches: LiveSearches,
        readings: Sequence[StampedInput[Any]],
        judging: Judging,
        held: Held,
        in_lockstep: bool,
    ) -> None:
        self._estimator, self._subscriptions = estimator, subscriptions
        self._outputs, self._beacon = outputs, beacon
        self._searches, self._reset = searches, Event()
        self._readings, self._in_lockstep = readings, in_lockstep
        self._judging, self._held = judging, held

    def reset(self, request: ResetRequest) -> Accepted:
        """Start the estimation again, and accept the present setups of the sensors."""
        check_reset(request)  # before anything changes
        self._subscriptions.request_reset(request)
        self._reset.set()
        return self._estimator.request_reset(request)

    def take(self, arrived: Arrived) -> None:
        """Process a frame, or begin to register it while frames of other sensors are processed."""
        if (due := self._held.due_before(arrived, self._estimator.may_pass)) is not None:
            self._process(due)
        if self._in_lockstep or not self._held.is_free:
            self.take_now(arrived)
            return
        self._take_readings(arrived)
        register = self._estimator.ahead(arrived)
        if register is None:
            self._process(arrived)
        else:
            self._held.hold(arrived, register)

    def take_held(self) -> None:
        """Process the frame that was registered in a thread, if there is one."""
        if (due := self._held.due()) is not None:
            self._process(due)

    def take_rest(self, waiting: Iterable[Arrived]) -> None:
        """Process the last frames; no time passes between them."""
        if (due := self._held.rest()) is not None:
            self._process(due)
        for arrived in waiting:
            self.take_now(arrived, lets_time_pass=False)

    def take_now(self, arrived: Arrived, *, lets_time_pass: bool = True) -> None:
        """Process a frame, after the readings and, in lockstep, the time up to its stamp."""
        self._take_readings(arrived)
        if arrived.came_in_time and self._in_lockstep and lets_time_pass:
            for output in self._estimator.let_time_pass(arrived.stamp_ns):
                self.publish(output)
        self._process(arrived)

    def _take_readings(self, arrived: Arrived) -> None:
        """Wait for the readings up to a frame's stamp."""
        if arrived.came_in_time:
            for each in self._readings:
                each.take_until(arrived.stamp_ns)

    def tick(self, now_ns: int) -> None:
        """Advance the time to a stamp with the readings that have arrived, and publish the results."""
        if not self._in_lockstep:
            for each in self._readings:
                each.take_in()
        self._judging.check()
        self.publish(self._estimator.tick(now_ns))
        for output in self._estimator.unreported(now_ns, self._searches):
            self.publish(output)

    def _process(self, arrived: Arrived) -> None:
        if self._reset.is_set():  # requests come from a thread of the bus
            self._reset.clear()
            self._searches.end_pauses()
        output = self._estimator.process(arrived)
        self.publish(output, arrived)
        self._subscriptions.health.judge(arrived, output, time.monotonic())
        self._subscriptions.health.rest(self._searches.pause_s)
        if output.status.accepted or output.status.mode not in (Mode.ACQUIRING, Mode.LOST):
            self._searches.end_pauses()

    def publish(self, output: Output | None, arrived: Arrived | None = None) -> None:
        """Publish a result, and with it whether it is valid; its integrity and status follow."""
        if output is None:
            return
        self._outputs.publish_estimate(output, self._beacon.take(output, arrived))
        since_s = arrived.arrival_s if arrived is not None else None
        frozen = arrived is not None and arrived.is_frozen
        self._judging.add(partial(self._judge, self._estimator.unjudged(output, frozen=frozen), since_s))

    def _judge(self, result: Unjudged, since_s: float | None) -> None:
        """Publish the integrity and the status of a result, whose frame arrived at ``since_s``."""
        integrity = self._estimator.judge(result)
        self._outputs.publish_judgement(result.output.status, integrity, since_s=since_s)
