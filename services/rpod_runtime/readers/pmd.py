"""The reader of a PMD camera: depth, amplitude and lens of a frame."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.errors import DistortionError
from rpod_geometry.lens import ray_cosines
from rpod_runtime.assembler import Assembled
from rpod_runtime.delivery.inbox import Received
from rpod_runtime.frames import ICD, PartRejectedError, SensorReader, read_part, sized
from rpod_runtime.sensor_data.codecs import decompressed
from rpod_runtime.sensor_data.exposure_watch import ExposureWatch
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_amplitude, read_camera, read_depth, read_pmd_info
from rpod_schemas.messages.header import read_text
from rpod_schemas.topics import COMPRESSED_IMAGE
from rpod_schemas.types import Camera, Float32Array, PmdFrame, PmdInfo

_HEADED_BYTES = 12
"""Size of a message's CDR header and stamp."""
_LEAST_PILE = 16
"""Least number of pixels with an image's largest value by which it counts as clipped."""
_PILED, _LEVELS = 5.0, 8
"""Least ratio of their number to that of pixels with each of the next lower values; number of such values."""


class PmdReader(SensorReader):
    """Reads the frames of a PMD camera."""

    newest_info: PmdInfo | None = None

    def __init__(self, source: SourceConfig = ICD) -> None:
        self._source = source
        self._cosines: tuple[bytes, Float32Array] | None = None
        self._exposures = ExposureWatch()

    @property
    def inconsistency(self) -> str:
        """How the images of the camera contradict each other; empty if they do not."""
        return self._exposures.text

    def learn(self, message: Any) -> None:
        """Store the latched info."""
        self.newest_info = read_pmd_info(message)

    def read(self, frame: Assembled[Received]) -> PmdFrame:
        """Return a frame: depth, amplitude where it was sent, lens model, and the camera's info."""
        camera = read_part(frame.parts["camera_info"], read_camera)
        size = (camera.height, camera.width)
        frame_id, depth_m = read_part(
            frame.parts["depth"],
            lambda message: (
                read_text("frame_id", message.header.frame_id),
                sized(read_depth(_plain(message), self._source.depth_unit_m), size, "depth"),
            ),
        )
        if self._source.depth == "radial":
            depth_m = self._along_boresight(frame.parts["camera_info"], camera, depth_m)
        amplitude = saturated = None
        if sent := frame.parts.get("amplitude"):
            amplitude = read_part(
                sent, lambda message: sized(read_amplitude(_plain(message)), size, "amplitude")
            )
            saturated = saturated_pixels(amplitude, self._source.saturated_amplitude)
        if saturated is not None:
            depth_m = np.where(saturated, np.float32(np.nan), depth_m)
            depth_m.setflags(write=False)
        read = PmdFrame(
            stamp_ns=frame.stamp_ns,
            frame_id=frame_id,
            depth_m=depth_m,
            amplitude=amplitude,
            camera=camera,
            info=self.newest_info,
            saturated=saturated,
        )
        self._exposures.take(read)
        return read

    def _along_boresight(self, received: Received, camera: Camera, range_m: Float32Array) -> Float32Array:
        """Return the z-depth of radial distances."""
        payload = bytes(received.payload[_HEADED_BYTES:])  # all but the stamp
        if self._cosines is None or self._cosines[0] != payload:
            try:
                self._cosines = payload, ray_cosines(camera).astype(np.float32)
            except DistortionError as error:
                rejection = MessageRejectedError(Reason.MALFORMED, str(error))
                raise PartRejectedError(received, rejection) from error
        depth_m = range_m * self._cosines[1]
        depth_m.setflags(write=False)
        return depth_m


def saturated_pixels(amplitude: NDArray[Any], limit: float | None) -> NDArray[np.bool_] | None:
    """Return the pixels of an amplitude image that are saturated, same shape; None if there are none.

    Without a limit these are the pixels with the largest value of an integer type, or with the largest value
    in the image if far more pixels have it than the values just below: then the image is clipped there.
    """
    if limit is not None:
        beyond: NDArray[np.bool_] = amplitude >= limit
        return beyond if beyond.any() else None
    integers = amplitude.dtype.kind == "u"
    largest = amplitude.max() if integers else np.nanmax(amplitude, initial=0)
    saturated: NDArray[np.bool_] = amplitude == largest
    if integers and largest == np.iinfo(amplitude.dtype).max:
        return saturated
    piled = np.count_nonzero(saturated)
    if piled < _LEAST_PILE or not largest > 0:
        return None
    below = amplitude[(amplitude < largest) & (amplitude > largest / 2)]
    counts = np.bincount(below) if integers else np.unique(below, return_counts=True)[1]
    counts = counts[counts > 0]
    gradual = counts.size >= _LEVELS and piled > _PILED * counts[-_LEVELS:].mean()
    return saturated if gradual else None


def _plain(message: Any) -> Any:
    """Return an image that is not compressed."""
    return decompressed(message) if message.__msgtype__ == COMPRESSED_IMAGE else message
