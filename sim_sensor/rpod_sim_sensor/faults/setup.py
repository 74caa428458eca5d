"""Faults of a sensor's description: its lens, its scan pattern, its mount, and how they are published."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.messages import (
    read_camera,
    read_lidar_info,
    read_stamp,
    read_transforms,
    write_camera,
    write_lidar_info,
    write_transforms,
)
from rpod_schemas.poses import chained, make_pose
from rpod_schemas.types import Camera
from rpod_sim_sensor.faults.injection import Injection, Outgoing


class Lens(Injection):
    """A fault of camera_info."""

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:
        """Return the message with another lens."""
        if outgoing.part != "camera_info":
            return [outgoing]
        header = outgoing.message.header
        camera = self.lens(read_camera(outgoing.message), elapsed_s)
        return [replace(outgoing, message=write_camera(read_stamp(header), header.frame_id, camera))]

    def lens(self, camera: Camera, elapsed_s: float) -> Camera:
        """Return the lens that is published."""
        raise NotImplementedError


class LensUnscaled(Lens):
    """The lens of twice the resolution."""

    fault = "lens_unscaled"

    def lens(self, camera: Camera, elapsed_s: float) -> Camera:  # noqa: ARG002
        """Return the lens with all lengths doubled."""
        update = {name: 2.0 * getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
        return camera.model_copy(update=update)


class LensChanges(Lens):
    """A focal length that changes by 3 % every 2 s."""

    fault = "lens_changes"

    def lens(self, camera: Camera, elapsed_s: float) -> Camera:
        """Return the lens of this time."""
        factor = 1.03 if elapsed_s % 4.0 >= 2.0 else 1.0
        return camera.model_copy(update={"fx": factor * camera.fx, "fy": factor * camera.fy})


class WrongPattern(Injection):
    """An info whose azimuths are 20 % wider than the scan."""

    fault = "wrong_pattern"

    def announcement(self, outgoing: Outgoing) -> list[Outgoing]:
        """Return the info of another scan mode."""
        if outgoing.part != "info":
            return [outgoing]
        info, header = read_lidar_info(outgoing.message), outgoing.message.header
        wider = info.model_copy(update={"azimuth_rad": 1.2 * info.azimuth_rad})
        return [replace(outgoing, message=write_lidar_info(read_stamp(header), header.frame_id, wider))]


class NotLatched(Injection):
    """Latched topics that are volatile."""

    fault = "not_latched"

    def announcement(self, outgoing: Outgoing) -> list[Outgoing]:
        """Return the message on a topic that is not latched."""
        return [replace(outgoing, topic=replace(outgoing.topic, latched=False))]


class NoMount(Injection):
    """No transform of the sensor."""

    fault = "no_mount"

    def announcement(self, outgoing: Outgoing) -> list[Outgoing]:
        """Return the info alone."""
        return [outgoing] if outgoing.part == "info" else []


class MountOff(Injection):
    """A mount that is 8 cm and 3 deg off, sideways."""

    fault = "mount_off"

    def announcement(self, outgoing: Outgoing) -> list[Outgoing]:
        """Return the transforms of another place."""
        return [outgoing if outgoing.part == "info" else self.moved(outgoing)]

    def moved(self, outgoing: Outgoing) -> Outgoing:
        """Return the sensor's transforms with another pose of the sensor in its own axes."""
        angle = np.random.default_rng([self.seed, 0x307]).uniform(0.0, 2.0 * np.pi)
        aside = np.array([np.cos(angle), np.sin(angle), 0.0])
        step: RigidTransform = make_pose(
            translation_m=0.08 * aside, rotation=Rotation.from_rotvec(np.deg2rad(3.0) * aside)
        )
        transforms = read_transforms(outgoing.message)
        links = [(parent, child, chained(pose, step)) for _, parent, child, pose in transforms]
        return replace(outgoing, message=write_transforms(transforms[0][0], links))


class SecondMount(MountOff):
    """A second publisher that gives the sensor another place."""

    fault = "second_mount"

    def announcement(self, outgoing: Outgoing) -> list[Outgoing]:
        """Return the message and that of the second publisher."""
        if outgoing.part == "info":
            return [outgoing]
        return [outgoing, replace(self.moved(outgoing), publisher="second")]


INJECTIONS: dict[str, type[Injection]] = {
    each.fault: each
    for each in (
        LensUnscaled, LensChanges, WrongPattern, NotLatched, NoMount, MountOff, SecondMount,
    )
}  # fmt: skip
"""Injections of this module by the fault's name."""
