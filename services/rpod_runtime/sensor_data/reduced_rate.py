"""Publishes a camera's stream of reduced rate: the newest complete frame as soon as the link has room for it.

The pace follows from stamps and sizes: after a frame of N bytes the next one is sent no sooner than the link
needs for N bytes. So a frame's parts stay together, nothing queues, and each run sends the same frames.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_runtime.delivery.publisher import Publisher
from rpod_runtime.node import Node
from rpod_runtime.sensor_data.shuffled import compressed
from rpod_schemas.config.pmd.reduced_rate import ReducedRateConfig
from rpod_schemas.messages import NANOSECONDS, write_camera, write_image
from rpod_schemas.topics import AMPLITUDE, CAMERA_INFO, COMPRESSED_IMAGE, DEPTH, Topic, optical_frame
from rpod_schemas.types import PmdFrame

_BITS = 8e-6
"""Megabits in a byte."""
_HEAD_BYTES = 500
"""Size of a camera_info, and largest overhead of an image, attachment and key included."""


class Pace:
    """Tells which frames a link has room for."""

    def __init__(self, mbit_s: float) -> None:
        self._mbit_s = mbit_s
        self._last_ns = self._next_ns = 0

    def allows(self, stamp_ns: int) -> bool:
        """Return whether a frame may be sent; stamps that go back begin anew."""
        return stamp_ns >= self._next_ns or stamp_ns < self._last_ns

    def sent(self, stamp_ns: int, size: int) -> None:
        """Note that a frame of a size was sent, bytes."""
        self._last_ns = stamp_ns
        self._next_ns = stamp_ns + round(size * _BITS / self._mbit_s * NANOSECONDS)


class ReducedRateCamera:
    """Publishes the stream of reduced rate of one camera. It lives as long as the node."""

    def __init__(self, node: Node, name: str, config: ReducedRateConfig) -> None:
        self._config, self._health, self._name = config, node.health, name
        self._frame_id = optical_frame(name)
        self._pace = Pace(config.mbit_s)
        self._depth = node.publisher(self._topic(DEPTH, "depth"))
        self._camera = node.publisher(Topic(f"{config.prefix}/{name}/camera_info", CAMERA_INFO.type))
        self._amplitude = node.publisher(self._topic(AMPLITUDE, "amplitude")) if config.amplitude else None

    def _topic(self, plain: Topic, part: str) -> Topic:
        packed, place = self._config.codec != "none", f"{self._config.prefix}/{self._name}/{part}"
        return (
            Topic(f"{place}/compressed", COMPRESSED_IMAGE)
            if packed
            else Topic(f"{place}/image_raw", plain.type)
        )

    def publish(self, frame: PmdFrame) -> None:
        """Publish a frame if the link has room for it."""
        if not self._pace.allows(frame.stamp_ns):
            return
        parts: list[tuple[Publisher, Any]] = [
            (self._camera, write_camera(frame.stamp_ns, self._frame_id, frame.camera)),
            (self._depth, self._image(frame.stamp_ns, frame.depth_m.astype(np.float32, copy=False), "32FC1")),
        ]
        if self._amplitude is not None and frame.amplitude is not None:
            encoding = {"uint8": "mono8", "uint16": "mono16"}.get(frame.amplitude.dtype.name, "32FC1")
            parts.append((self._amplitude, self._image(frame.stamp_ns, frame.amplitude, encoding)))
        size = 0
        for publisher, message in parts:
            publisher.publish(message)
            size += _HEAD_BYTES + (message.data.nbytes if publisher is not self._camera else 0)
        self._pace.sent(frame.stamp_ns, size)
        self._health.count(f"reduced_rate/{self._name}")
        self._health.put(f"reduced_rate_bytes/{self._name}", size)

    def _image(self, stamp_ns: int, image: NDArray[Any], encoding: str) -> Any:
        if self._config.codec == "none":
            return write_image(stamp_ns, self._frame_id, np.ascontiguousarray(image), encoding)
        return compressed(stamp_ns, self._frame_id, image, encoding)
