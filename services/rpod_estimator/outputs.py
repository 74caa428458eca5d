"""Publishing of the estimator's results: odometry, pose, frames and joints, transform, integrity, status."""

import time

import numpy as np

from rpod_pose.navigation.state import Output
from rpod_runtime import Node
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import (
    NANOSECONDS,
    write_image,
    write_integrity,
    write_joints,
    write_odometry,
    write_pose_stamped,
    write_status,
    write_transforms,
    write_validity,
)
from rpod_schemas.topics import (
    CHASER,
    CONTRADICTION,
    ESTIMATE,
    ESTIMATE_FRAME,
    ESTIMATE_JOINTS,
    ESTIMATE_POSE,
    INTEGRITY,
    STATUS,
    TARGET_ESTIMATE,
    TF,
    VALIDITY,
)
from rpod_schemas.types import EstimateValidity, EstimatorStatus, Integrity
from rpod_target import Target

_TF_PERIOD_NS = NANOSECONDS // 25


class Outputs:
    """Publishers of the estimator's results, for a target with the frames and joints that its file names."""

    def __init__(self, node: Node, prefix: str, target: Target) -> None:
        self._node = node
        self._odometry = node.publisher(ESTIMATE.under(prefix))
        self._pose = node.publisher(ESTIMATE_POSE.under(prefix))
        self._frames = [
            (node.publisher(ESTIMATE_FRAME.under(prefix).at(name)), T_target_frame)
            for name, T_target_frame in target.frames.items()
        ]
        self._contradiction = node.publisher(CONTRADICTION.under(prefix))
        self._validity = node.publisher(VALIDITY.under(prefix))
        self._integrity = node.publisher(INTEGRITY.under(prefix))
        self._joints = node.publisher(ESTIMATE_JOINTS.under(prefix)) if target.joints else None
        self._status = node.publisher(STATUS.under(prefix))
        self._tf = node.publisher(TF)
        self._tf_ns = 0

    def publish_validity(self, validity: EstimateValidity) -> None:
        """Publish the validity of the newest estimate."""
        self._validity.publish(write_validity(validity))

    def publish_estimate(self, output: Output, validity: EstimateValidity) -> None:
        """Publish an estimate and its validity at once, since a controller waits for them."""
        odometry = output.odometry
        if odometry is not None:
            self._odometry.publish(write_odometry(odometry))
            self._pose.publish(write_pose_stamped(odometry))
            for publisher, T_target_frame in self._frames:
                publisher.publish(write_pose_stamped(odometry, T_child_frame=T_target_frame))
            if not 0 <= odometry.stamp_ns - self._tf_ns < _TF_PERIOD_NS:  # also after a clock was set back
                self._tf_ns = odometry.stamp_ns
                transform = (CHASER, TARGET_ESTIMATE, odometry.pose)
                self._tf.publish(write_transforms(odometry.stamp_ns, [transform]))
        if output.joints is not None and self._joints is not None:
            self._joints.publish(write_joints(output.joints))
        if output.refused is not None:
            image = output.refused.marks.marked * np.uint8(255)
            message = write_image(output.status.stamp_ns, output.refused.frame_id, image, "mono8")
            self._contradiction.publish(message)
        self.publish_validity(validity)

    def publish_judgement(
        self, status: EstimatorStatus, integrity: Integrity, *, since_s: float | None = None
    ) -> None:
        """Publish the integrity of an estimate, and last its status, because lockstep waits for the status.

        ``since_s`` is the arrival of the frame's last part on the monotonic clock.
        """
        self._integrity.publish(write_integrity(integrity))
        if since_s is not None:
            status = status.model_copy(update={"processing_s": time.monotonic() - since_s})
        self._publish_status(status)

    def _publish_status(self, status: EstimatorStatus) -> None:
        """Publish a status, or a short one that reports that it exceeds the bounds of its message."""
        try:
            message = write_status(status)
        except MessageRejectedError as error:
            self._node.reject(self._status.topic.name, error)
            kept = status.model_dump(include={"stamp_ns", "frame_id", "mode", "sensor"})
            message = write_status(EstimatorStatus(**kept, reason=f"the status cannot be sent: {error}"))
        self._status.publish(message)
