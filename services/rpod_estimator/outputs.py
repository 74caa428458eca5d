"""The estimator's voice: odometry, pose, transform and status."""

import time

from rpod_pose.navigation.state import Output
from rpod_runtime import Node
from rpod_schemas.messages import (
    NANOSECONDS,
    write_odometry,
    write_pose_stamped,
    write_status,
    write_transforms,
)
from rpod_schemas.topics import CHASER, ESTIMATE, ESTIMATE_POSE, STATUS, TARGET_ESTIMATE, TF

_TF_PERIOD_NS = NANOSECONDS // 25


class Outputs:
    """Publishers of everything that the estimator says."""

    def __init__(self, node: Node, prefix: str) -> None:
        self._odometry = node.publisher(ESTIMATE.under(prefix))
        self._pose = node.publisher(ESTIMATE_POSE.under(prefix))
        self._status = node.publisher(STATUS.under(prefix))
        self._tf = node.publisher(TF)
        self._tf_ns = 0

    def publish(self, output: Output | None, *, since_s: float | None = None) -> None:
        """Publish a result; the status comes last, for those who wait for it.

        ``since_s`` is the arrival of the frame's last part on the monotonic clock.
        """
        if output is None:
            return
        odometry = output.odometry
        if odometry is not None:
            self._odometry.publish(write_odometry(odometry))
            self._pose.publish(write_pose_stamped(odometry))
            if odometry.stamp_ns - self._tf_ns >= _TF_PERIOD_NS:
                self._tf_ns = odometry.stamp_ns
                transform = (CHASER, TARGET_ESTIMATE, odometry.pose)
                self._tf.publish(write_transforms(odometry.stamp_ns, [transform]))
        status = output.status
        if since_s is not None:
            status = status.model_copy(update={"processing_s": time.monotonic() - since_s})
        self._status.publish(write_status(status))
