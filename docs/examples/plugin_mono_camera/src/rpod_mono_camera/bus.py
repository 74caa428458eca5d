"""From frames to messages and back."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_mono_camera.frame import ENCODINGS, MonoFrame
from rpod_mono_camera.kind import IMAGE
from rpod_runtime import Node, Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.frames import SensorReader, read_part, sized
from rpod_runtime.sensors import announce_mount
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.messages import build, read_camera, read_image, write_camera, write_image
from rpod_schemas.topics import CAMERA_INFO, optical_frame


class MonoReader(SensorReader):
    """Frames of a monocular camera, which publishes no info of itself."""

    def __init__(self, source: SourceConfig) -> None:
        """Take how the driver publishes; images need nothing of it."""

    def learn(self, message: Any) -> None:
        """Take nothing."""

    def read(self, frame: Assembled[Received]) -> MonoFrame:
        """Return the image with its camera."""
        camera = read_part(frame.parts["camera_info"], read_camera)

        def read(message: Any) -> MonoFrame:
            image = sized(read_image(message), (camera.height, camera.width))
            image = image.astype(image.dtype.newbyteorder("="), copy=False)
            frame_id = str(message.header.frame_id)
            return build(MonoFrame, stamp_ns=frame.stamp_ns, frame_id=frame_id, image=image, camera=camera)

        return read_part(frame.parts["image"], read)


class MonoPublisher:
    """A monocular camera on the bus: rpod_runtime.sensors.SensorPublisher."""

    frame_type, info_type = MonoFrame, None

    def __init__(self, node: Node, name: str, *, T_chaser_sensor: RigidTransform) -> None:
        self.frame_id = optical_frame(name)
        announce_mount(node, self.frame_id, T_chaser_sensor)
        self._camera_info = node.publisher(CAMERA_INFO.of(name))
        self._image = node.publisher(IMAGE.of(name))

    def announce(self, info: Any) -> None:
        """Say nothing."""

    def publish(self, frame: MonoFrame) -> None:
        """Publish camera_info and image under one stamp."""
        image = np.ascontiguousarray(frame.image)
        encoding = ENCODINGS[image.dtype.name]
        self._camera_info.publish(write_camera(frame.stamp_ns, self.frame_id, frame.camera))
        self._image.publish(write_image(frame.stamp_ns, self.frame_id, image, encoding))
