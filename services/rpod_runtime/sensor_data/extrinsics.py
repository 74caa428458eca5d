"""Mounts of the sensors on the chaser, from ``tf_static`` and from the configuration."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_runtime.delivery.holders import UNKNOWN_PEER, Announcements, Peer
from rpod_runtime.errors import ExtrinsicsError
from rpod_schemas.arrays import FloatArray
from rpod_schemas.bounds import MOUNT_M
from rpod_schemas.poses import chained, rotation_of
from rpod_schemas.topics import CHASER

_AGREE_M = 1e-4
_AGREE_RAD = 1e-4
_MOST_NAMED = 6
"""Largest number of frames that a text names."""
MOST_LINKS = 100
"""Largest number of transforms from a sensor to the chaser."""


class Extrinsics:
    """Keeps the mounts from ``tf_static`` and from the configuration; where both give one they must agree."""

    def __init__(self, configured: dict[str, RigidTransform | None]) -> None:
        self._configured = configured
        self.announced: Announcements[tuple[str, RigidTransform]] = Announcements()
        """Parent and T_parent_child by child frame, as each publisher gives them."""

    def set(self, parent: str, child: str, T_parent_child: RigidTransform, peer: Peer = UNKNOWN_PEER) -> None:
        """Store a static transform of a publisher. Raises ``MessageRejectedError`` if there are too many."""
        self.announced.put(child, peer, (parent, T_parent_child))

    def mount(self, sensor: str, frame_id: str, session: str = "") -> RigidTransform:
        """Return the mount of a sensor whose messages are stamped with a frame.

        Transforms that ``session``, which sends the messages, has published itself count first.

        Raises:
            ExtrinsicsError: no source gives the mount, two sources differ, or the sensor is too far from the
                chaser's origin.
        """
        measured = self._chain(frame_id, session)
        configured = self._configured.get(sensor)
        mount = configured if measured is None else measured
        if mount is None:
            raise ExtrinsicsError(self._no_chain(frame_id, session))
        try:
            MOUNT_M.check(float(np.linalg.norm(mount.translation)))
        except ValueError as error:
            raise ExtrinsicsError(f"distance of {frame_id!r} from {CHASER!r} {error}") from error
        if measured is not None and configured is not None and differ(measured, configured):
            raise ExtrinsicsError(
                f"tf_static and the configured T_chaser_sensor of {sensor!r} differ by "
                f"{apart(measured, configured)}: correct one of them, or leave T_chaser_sensor out of the "
                "configuration"
            )
        return mount

    def _no_chain(self, frame_id: str, session: str) -> str:
        """Return that a frame has no chain to the chaser, with what is known instead, and the remedy."""
        text = f"no chain from {frame_id!r} to {CHASER!r}"
        remedy = "publish it on tf_static (tf itself is not read), or configure T_chaser_sensor"
        if not frame_id:
            return f"{text}: the frame_id is empty; let the driver set header.frame_id, or {remedy}"
        bare = frame_id.lstrip("/")
        if bare != frame_id and self._chain(bare, session) is not None:
            return (
                f"{text}, but one from {bare!r}: let the driver leave out the slash; frames of tf2 have none"
            )
        frame, frames = frame_id, [frame_id]
        while (found := self.announced.of(frame, session)) is not None and found[1][0] not in frames:
            frame = found[1][0]
            frames.append(frame)
        if len(frames) > 1:
            return f"{text}: it ends at {frame!r}; {remedy} of the whole"
        known = ", ".join(sorted(self.announced.names)[:_MOST_NAMED])
        return f"{text}: {remedy}; tf_static has {known or 'nothing'}"

    def leave_unknown(self, frame_id: str) -> None:
        """Note that publishers of unknown sessions may be gone: the newest of their transforms count.

        These are the transforms from a frame to the chaser.
        """
        frame, names = frame_id, set[str]()
        while frame not in names and (found := self.announced.of(frame, "")) is not None:
            names.add(frame)
            _, (frame, _) = found
        self.announced.leave(names.__contains__, "")

    def _chain(self, frame_id: str, session: str) -> RigidTransform | None:
        T_frame_sensor = RigidTransform.identity()
        frame = frame_id
        for _ in range(MOST_LINKS):
            if frame == CHASER:
                return T_frame_sensor
            found = self.announced.of(frame, session)
            if found is None:
                return None
            _, (frame, T_parent_child) = found
            T_frame_sensor = chained(T_parent_child, T_frame_sensor)
        return None  # the frames form a loop

    def rivals(self, frame_id: str) -> tuple[Peer, Peer] | None:
        """Return two publishers that give a frame another place; None if all agree."""
        given = self.announced.rivals(frame_id)
        for other, (parent, pose) in given[1:]:
            if parent != given[0][1][0] or differ(given[0][1][1], pose):
                return given[0][0], other
        return None


def differ(first: RigidTransform, second: RigidTransform) -> bool:
    """Return whether two poses differ by more than rounding."""
    step = chained(first.inv(), second)
    return bool(abs(step.translation).max() > _AGREE_M or rotation_of(step).magnitude() > _AGREE_RAD)


def apart(first: RigidTransform, second: RigidTransform) -> str:
    """Return how far two poses are apart: "0.100 m and 1.00 deg"."""
    step = chained(first.inv(), second)
    away_m, turned_deg = float(np.linalg.norm(step.translation)), np.rad2deg(rotation_of(step).magnitude())
    return f"{away_m:.3f} m and {turned_deg:.2f} deg"


def in_words(T_chaser_sensor: RigidTransform) -> str:
    """Return a mount as a person checks it: place, boresight and right of the image, by the chaser's axes.

    Args:
        T_chaser_sensor: mount of the axes x right, y down, z along the boresight.
    """
    x_m, y_m, z_m = T_chaser_sensor.translation
    right, _, boresight = T_chaser_sensor.rotation.as_matrix().T
    return (
        f"at ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m of the chaser, looks along {_axis(boresight)}, right of its "
        f"image is {_axis(right)}"
    )


def _axis(direction: FloatArray) -> str:
    """Return the chaser's axis that is nearest to a direction, with the angle between both."""
    nearest = int(np.abs(direction).argmax())
    off_deg = float(np.degrees(np.arccos(min(abs(direction[nearest]), 1.0))))
    return f"{'+' if direction[nearest] > 0 else '-'}{'xyz'[nearest]} ({off_deg:.1f} deg off)"
