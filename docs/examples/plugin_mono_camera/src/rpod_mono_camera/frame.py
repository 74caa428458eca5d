"""One image of a monocular camera."""

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from rpod_schemas.types import Camera, FrameImage, Image, SensorFrame

ENCODINGS = {"uint8": "mono8", "uint16": "mono16"}
"""Encoding of ``sensor_msgs/Image`` by the image's type."""


class MonoFrame(SensorFrame):
    """One exposure; ``frame_id`` is the optical frame."""

    image: Image
    """Grey values, shape (height, width), uint8 or uint16."""
    camera: Camera

    @property
    def lens(self) -> Camera:
        """The camera."""
        return self.camera

    @property
    def images(self) -> tuple[FrameImage, ...]:
        """The image."""
        return (FrameImage("image", self.image, "grey"),)

    @property
    def brightness(self) -> NDArray[np.float32]:
        """The image as numbers to work on, shape (height, width)."""
        return self.image.astype(np.float32)

    @model_validator(mode="after")
    def _is_a_grey_image_of_the_camera(self) -> Self:
        if self.image.dtype.name not in ENCODINGS:
            raise ValueError(f"image is {self.image.dtype.name}, needs uint8 or uint16")
        size = (self.camera.height, self.camera.width)
        if self.image.shape != size:
            raise ValueError(f"image is {self.image.shape}, camera_info says {size}")
        return self
