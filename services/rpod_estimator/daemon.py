"""The estimator daemon: connects the estimator to the bus and the clock."""

import time
from threading import Event

from rpod_estimator.estimator import TICK_S, Estimator
from rpod_estimator.outputs import Outputs
from rpod_estimator.subscriptions import Subscriptions
from rpod_runtime import Node
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.control import Accepted, ResetRequest
from rpod_target import load_target


def run(config: EstimatorConfig, *, version: str, stop: Event) -> None:
    """Estimate until stopped."""
    target = load_target(config.target)
    estimator = Estimator(config, target)
    with Node(config, version=version, stop=stop) as node:
        node.target_digest = target.digest
        subscriptions, outputs = Subscriptions(node, config), Outputs(node, config.prefix, target.frames)

        def reset(request: ResetRequest) -> Accepted:
            subscriptions.request_reset(request)
            return estimator.request_reset(request)

        node.serve("reset", ResetRequest, reset)
        node.ready(f"listening to {', '.join(sensor.name for sensor in config.sensors)}")
        while not stop.is_set():
            subscriptions.pin(estimator.pins_setups)
            arrived = subscriptions.newest(TICK_S)
            estimator.learn(subscriptions.infos)
            if arrived is not None:
                if config.time_source == "clock":
                    for output in estimator.let_time_pass(arrived.stamp_ns):
                        outputs.publish(output)
                output = estimator.process(arrived)
                outputs.publish(output, since_s=arrived.arrival_s)
                subscriptions.health.judge(arrived, output.status, time.monotonic())
            outputs.publish(estimator.tick(node.clock.settled_ns()))
            subscriptions.health.report(estimator.mode, time.monotonic())
        for arrived in subscriptions.rest():  # each frame gets a status or is counted
            outputs.publish(estimator.process(arrived), since_s=arrived.arrival_s)
