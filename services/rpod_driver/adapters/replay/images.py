"""Frames of a folder of PNG images."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_driver.adapters.replay.config import Images
from rpod_driver.errors import RecordingError
from rpod_driver.registered import sdk
from rpod_geometry.lens import ray_cosines
from rpod_schemas.messages import NANOSECONDS, is_measured
from rpod_schemas.types import PmdFrame


class ImageFolder:
    """A camera whose frames are in a folder."""

    def __init__(self, images: Images) -> None:
        """Find the images, and read the first. Raises ``RecordingError``, ``MissingSdkError``."""
        self._images = images
        self._cv2 = sdk("cv2", driver="replay", needs="images need pip install 'rpod[estimator]'")
        self._depths = sorted(images.folder.glob(images.depth))
        self._amplitudes = sorted(images.folder.glob(images.amplitude)) if images.amplitude else []
        if not self._depths:
            raise RecordingError(
                images.folder, f"holds no image {images.depth!r}; correct images.folder or depth"
            )
        if images.amplitude and len(self._amplitudes) != len(self._depths):
            raise RecordingError(
                images.folder,
                f"holds {len(self._depths)} images {images.depth!r} and {len(self._amplitudes)} "
                f"{images.amplitude!r}; each depth needs its amplitude",
            )
        self._factor = images.metres_per_count * (ray_cosines(images.camera) if images.radial else 1.0)
        next(self.frames())  # an error of the first image is told now

    def info(self) -> None:
        """Return None: images do not describe the camera."""

    def frames(self) -> Iterator[PmdFrame]:
        """Yield a frame for each depth image, stamped by its number. Raises ``RecordingError``."""
        amplitudes: list[Path | None] = [*self._amplitudes] or [None] * len(self._depths)
        for number, (depth, amplitude) in enumerate(zip(self._depths, amplitudes, strict=True)):
            counts = self._image(depth, ("uint16",))
            metres = np.where(is_measured(counts), counts * self._factor, np.nan).astype(np.float32)
            yield PmdFrame(
                stamp_ns=round(number / self._images.rate_hz * NANOSECONDS),
                frame_id="",
                depth_m=metres,
                amplitude=None if amplitude is None else self._image(amplitude, ("uint8", "uint16")),
                camera=self._images.camera,
            )

    def _image(self, file: Path, types: tuple[str, ...]) -> NDArray[Any]:
        image: NDArray[Any] | None = self._cv2.imread(str(file), self._cv2.IMREAD_UNCHANGED)
        if image is None:
            raise RecordingError(file, "cannot be read as an image; remove it or write it again")
        size = (self._images.camera.height, self._images.camera.width)
        if image.dtype.name not in types or image.shape != size:
            raise RecordingError(
                file,
                f"has shape {image.shape} and type {image.dtype.name}, needs {size} (images.camera) and "
                f"{' or '.join(types)}",
            )
        return image
