"""The method itself; imported by the process that estimates, and by no other."""

from scipy.spatial.transform import RigidTransform

from my_distance import MyDistanceConfig
from rpod_pose.pmd.signed_distance import SignedDistanceTracker
from rpod_pose.ports import Registration, Task
from rpod_schemas.types import PmdFrame


class MyDistance(SignedDistanceTracker):
    """Registers PMD frames."""

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the pose with its belief, from a predicted pose. Your idea goes here."""
        return super().track(measurement, T_sensor_target)


def build(config: MyDistanceConfig, task: Task) -> MyDistance:
    """Return the method for a target."""
    return MyDistance(config, task.target)
