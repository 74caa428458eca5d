"""The estimator's settings for a sequence."""

from functools import lru_cache

from rpod_campaign.lidar.methods import tracking_input
from rpod_campaign.pmd.scene import camera_of, scenario_of
from rpod_campaign.sequences.course import CourseCell
from rpod_schemas.config.estimator import EstimatorSettings, PmdInput
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.sensor import SensorInput


@lru_cache(maxsize=8)
def inputs_of(cell: CourseCell) -> tuple[SensorInput, ...]:
    """Return the estimator's inputs for the sensors of a cell's sequences."""
    lidar = tracking_input("projective")
    inputs: tuple[SensorInput, ...] = ()
    if cell.document:
        scenario = scenario_of(cell.document)
        camera = camera_of(scenario).name
        inputs = tuple(
            each.model_copy(update={"name": "pmd"})
            for each in scenario.estimator.sensors
            if isinstance(each, PmdInput) and each.name == camera
        )
    return inputs if cell.sensor == "pmd" else (*inputs, lidar)


def settings_of(cell: CourseCell) -> EstimatorSettings:
    """Return the scenario's settings with the cell's sensors.

    The LIDAR alone has the settings of a user who knows that the target moves without torque, and that its
    file is exact.
    """
    if not cell.document:
        return EstimatorSettings(
            sensors=inputs_of(cell),
            filter=FilterConfig(errors="considered"),
            dynamics=DynamicsConfig(target="torque_free"),
        )
    return scenario_of(cell.document).estimator.model_copy(update={"sensors": inputs_of(cell)})
