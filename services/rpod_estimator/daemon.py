"""The estimator daemon: connects the estimator to the bus and the clock."""

import time
from collections import defaultdict
from threading import Event

from rpod_estimator.backoff import Backoff
from rpod_estimator.estimator import TICK_S, Estimator
from rpod_estimator.frame_reader import Arrived
from rpod_estimator.imu_input import ImuInput
from rpod_estimator.outputs import Outputs
from rpod_estimator.subscriptions import Subscriptions
from rpod_estimator.validity import Beacon, Validity
from rpod_pose.navigation.state import Output
from rpod_runtime import Node
from rpod_runtime.notify import manager
from rpod_runtime.ros import RESET_SERVICE
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.control import Accepted, ResetRequest
from rpod_schemas.errors import Reason
from rpod_target import load_target


def run(config: EstimatorConfig, *, version: str, stop: Event) -> None:
    """Estimate until stopped."""
    target = load_target(config.target)
    estimator = Estimator(config, target)
    with Node(config, version=version, stop=stop) as node:
        node.target_digest, node.target_content = target.digest, target.content_digest
        subscriptions, outputs = Subscriptions(node, config), Outputs(node, config.prefix, target)
        imu = ImuInput(node, config, estimator.imu)
        validity = Validity(config.stale_after_s)
        with Beacon(validity, outputs.tell, node.clock) as beacon:
            service = _Service(estimator, subscriptions, outputs, validity, beacon)
            node.serve("reset", ResetRequest, service.reset, ros=RESET_SERVICE)
            node.ready(f"listening to {', '.join(sensor.name for sensor in config.sensors)}")
            while not stop.is_set():
                manager.alive()
                subscriptions.pin(estimator.pins_setups)
                arrived = subscriptions.newest(TICK_S)
                estimator.learn(subscriptions.infos)
                if arrived is not None:
                    imu.hear_up_to(arrived.stamp_ns)
                    if config.time_source == "clock":
                        for output in estimator.let_time_pass(arrived.stamp_ns):
                            service.publish(output)
                    if not service.rests(arrived):
                        service.process(arrived)
                service.publish(estimator.tick(node.clock.settled_ns()))
                subscriptions.health.report(estimator.mode, subscriptions.heard_until_s)
            for arrived in subscriptions.rest():  # each frame gets a status or is counted
                imu.hear_up_to(arrived.stamp_ns)
                service.process(arrived)


class _Service:
    """The estimator with all that is told of its results."""

    def __init__(
        self,
        estimator: Estimator,
        subscriptions: Subscriptions,
        outputs: Outputs,
        validity: Validity,
        beacon: Beacon,
    ) -> None:
        self._estimator, self._subscriptions = estimator, subscriptions
        self._outputs, self._validity, self._beacon = outputs, validity, beacon
        self._backoffs = defaultdict[str, Backoff](Backoff)

    def reset(self, request: ResetRequest) -> Accepted:
        """Start again, with the sensors as they are set up now."""
        self._subscriptions.request_reset(request)
        self._end_rests()
        return self._estimator.request_reset(request)

    def rests(self, arrived: Arrived) -> bool:
        """Return whether a frame is passed over, because searches have been in vain for long."""
        rests = self._backoffs[arrived.sensor].rests(arrived, time.monotonic())
        pause_s = max(each.pause_s for each in self._backoffs.values())
        self._subscriptions.health.rest(arrived.sensor if rests else "", pause_s)
        return rests

    def _end_rests(self) -> None:
        for backoff in self._backoffs.values():
            backoff.end()

    def process(self, arrived: Arrived) -> None:
        """Process a frame and publish the result."""
        began_s = time.monotonic()
        output = self._estimator.process(arrived)
        self.publish(output, arrived)
        now_s = time.monotonic()
        self._subscriptions.health.judge(arrived, output.status, now_s)
        if not self._beacon.is_silent:  # results must not depend on the machine's speed
            self._backoffs[arrived.sensor].take(arrived, output, began_s=began_s, now_s=now_s)
            if output.status.accepted:
                self._end_rests()

    def publish(self, output: Output | None, arrived: Arrived | None = None) -> None:
        """Publish a result, and with it whether it is valid."""
        if output is not None:
            self._validity.take(output, arrived, now_s=self._beacon.arrival_s(arrived))
            since_s = arrived.arrival_s if arrived is not None else None
            frozen = arrived is not None and arrived.refused == Reason.FROZEN
            integrity = self._estimator.integrity(output, frozen=frozen)
            self._outputs.publish(output, self._beacon.current(), integrity, since_s=since_s)
