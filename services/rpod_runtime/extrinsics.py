"""Mounts of the sensors on the chaser, from ``tf_static`` and from the configuration."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_runtime.errors import ExtrinsicsError
from rpod_schemas.bounds import MOUNT_M
from rpod_schemas.poses import chained, rotation_of
from rpod_schemas.topics import CHASER

_AGREE_M = 1e-4
_AGREE_RAD = 1e-4


class Extrinsics:
    """Keeps the mounts from ``tf_static`` and from the configuration; where both give one they must agree."""

    def __init__(self, configured: dict[str, RigidTransform | None]) -> None:
        self._configured = configured
        self._parents: dict[str, tuple[str, RigidTransform]] = {}

    def set(self, parent: str, child: str, T_parent_child: RigidTransform) -> None:
        """Store one static transform."""
        self._parents[child] = parent, T_parent_child

    def mount(self, sensor: str, frame_id: str) -> RigidTransform:
        """Return the mount of a sensor whose messages are stamped with a frame.

        Raises:
            ExtrinsicsError: no source gives the mount, two sources differ, or the sensor is too far from the
                chaser's origin.
        """
        measured = self._chain(frame_id)
        configured = self._configured.get(sensor)
        mount = configured if measured is None else measured
        if mount is None:
            raise ExtrinsicsError(
                f"no chain from {frame_id!r} to {CHASER!r}: publish it on tf_static, "
                "or configure T_chaser_sensor"
            )
        try:
            MOUNT_M.check(float(np.linalg.norm(mount.translation)))
        except ValueError as error:
            raise ExtrinsicsError(f"distance of {frame_id!r} from {CHASER!r} {error}") from error
        if measured is not None and configured is not None and _differ(measured, configured):
            raise ExtrinsicsError(
                f"tf_static and the configured T_chaser_sensor of {sensor!r} differ: correct one of them, "
                "or leave T_chaser_sensor out of the configuration"
            )
        return mount

    def _chain(self, frame_id: str) -> RigidTransform | None:
        T_frame_sensor = RigidTransform.identity()
        frame = frame_id
        for _ in range(len(self._parents) + 1):
            if frame == CHASER:
                return T_frame_sensor
            if frame not in self._parents:
                return None
            frame, T_parent_child = self._parents[frame]
            T_frame_sensor = chained(T_parent_child, T_frame_sensor)
        return None  # the frames form a loop


def _differ(first: RigidTransform, second: RigidTransform) -> bool:
    step = chained(first.inv(), second)
    return bool(abs(step.translation).max() > _AGREE_M or rotation_of(step).magnitude() > _AGREE_RAD)
