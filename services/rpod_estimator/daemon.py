"""The estimator daemon: a thin shell of bus and clock around the estimator."""

from threading import Event

from rpod_estimator.estimator import TICK_S, Estimator
from rpod_estimator.inputs import Inputs
from rpod_estimator.outputs import Outputs
from rpod_runtime import Node
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.control import ResetRequest
from rpod_schemas.types import Health, Mode
from rpod_target import load_target


def run(config: EstimatorConfig, *, version: str, stop: Event) -> None:
    """Estimate until stopped."""
    target = load_target(config.target)
    estimator = Estimator(config, target)
    with Node(config, version=version, stop=stop) as node:
        node.target_digest = target.digest
        inputs, outputs = Inputs(node, config), Outputs(node, config.prefix)
        node.serve("reset", ResetRequest, estimator.request_reset)
        node.ready(f"listening to {', '.join(sensor.name for sensor in config.sensors)}")
        while not stop.is_set():
            arrived = inputs.newest(TICK_S)
            estimator.use_patterns(inputs.patterns)
            if arrived is not None:
                if config.time_source == "clock":
                    for output in estimator.let_time_pass(arrived.stamp_ns):
                        outputs.publish(output)
                outputs.publish(estimator.process(arrived), since_s=arrived.arrival_s)
            outputs.publish(estimator.tick(node.clock.settled_ns()))
            level = Health.WARN if estimator.mode == Mode.LOST else Health.OK
            node.health.report(level, estimator.mode.name.lower())
        for arrived in inputs.rest():  # no frame goes without an answer or a count
            outputs.publish(estimator.process(arrived), since_s=arrived.arrival_s)
