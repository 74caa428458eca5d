"""Frames of an ifm O3R from its images, recorded or live."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_driver.adapters.ifm.chunks import (
    AMPLITUDE,
    CONFIDENCE,
    DISTANCE_NOISE,
    RADIAL_DISTANCE,
    TOF_INFO,
    Chunk,
)
from rpod_driver.adapters.ifm.tof_info import TofInfo, TofInfoError, read_tof_info
from rpod_driver.errors import RecordingError
from rpod_geometry.lens import ray_cosines
from rpod_schemas.types import Camera, Float32Array, PmdFrame

_COARSEST = 1e6
"""Largest value of one count: far above that of any device, so that products stay finite."""
_INVALID = 1
"""Bit of a pixel's confidence: it is not valid (ifm documentation, confidenceImage.md)."""


@dataclass(frozen=True)
class IfmImages:
    """The images of one frame, in metres and in the device's units, each of shape (height, width)."""

    stamp_ns: int
    """Stamp by the device's clock, ns: the middle of the exposures if the device states them."""
    range_m: Float32Array
    """Radial distance, m; 0 where there is none."""
    sigma_m: Float32Array | None
    """Standard deviation of the radial distance, m."""
    amplitude: Float32Array | None
    """Amplitude, normalised over the exposure times; negative where there is none."""
    confidence: NDArray[Any] | None
    """Bits that state why a pixel is not valid."""
    tof_info: TofInfo | None
    problem: str = ""
    """Reason why there is no ``tof_info``."""


def images_of(chunks: dict[int, Chunk]) -> IfmImages:
    """Return the images of a recorded buffer, in the units of o3r_uncompress_di.cpp.

    Raises:
        RecordingError: there is no radial distance, or no resolution for it.
    """
    if RADIAL_DISTANCE not in chunks:
        told = ", ".join(str(kind) for kind in sorted(chunks)) or "none"
        raise RecordingError(
            "buffer", f"no image {RADIAL_DISTANCE} (radial distance), it holds {told}; record it too"
        )
    distance = chunks[RADIAL_DISTANCE]
    others = [chunks[kind] for kind in (AMPLITUDE, DISTANCE_NOISE, CONFIDENCE) if kind in chunks]
    for other in others:
        if (other.width, other.height) != (distance.width, distance.height):
            raise RecordingError(
                "buffer",
                f"image {other.type} has {other.width} x {other.height} pixels, the radial distance "
                f"{distance.width} x {distance.height}; record it again",
            )
    info, problem = tof_info_of(chunks[TOF_INFO].data if TOF_INFO in chunks else b"")
    metres = _resolution(distance, "DistanceResolution", None if info is None else info.distance_resolution_m)
    noise = chunks.get(DISTANCE_NOISE)
    return IfmImages(
        stamp_ns=middle_ns(info, distance.stamp_ns),
        range_m=_scaled(distance, metres),
        sigma_m=None if noise is None else _scaled(noise, metres),
        amplitude=_amplitude(chunks.get(AMPLITUDE), info),
        confidence=_bits(chunks.get(CONFIDENCE)),
        tof_info=info,
        problem=problem,
    )


def tof_info_of(data: bytes) -> tuple[TofInfo | None, str]:
    """Return the content of TOF_INFO, or None and the reason why it cannot be used."""
    if not data:
        return None, "the frame has no TOF_INFO; give the lens as device.calibration"
    try:
        return read_tof_info(data), ""
    except TofInfoError as error:
        return None, str(error)


def middle_ns(info: TofInfo | None, stamp_ns: int) -> int:
    """Return the middle of a frame's exposures by the device's clock, ns; the stamp if it states none."""
    exposures = info.exposures_ns if info else ()
    return (min(exposures) + max(exposures)) // 2 if exposures else stamp_ns


def _resolution(chunk: Chunk, name: str, of_info: float | None) -> float:
    """Return the value of one count, from the metadata or else from TOF_INFO. Raises ``RecordingError``."""
    given = chunk.metadata.get(name, of_info)
    if given is None:
        raise RecordingError(
            "buffer",
            f"neither metadata nor TOF_INFO give {name} of image {chunk.type}; record TOF_INFO too, or "
            "update the firmware",
        )
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 < given <= _COARSEST:
        raise RecordingError(
            "buffer",
            f"{name} of image {chunk.type} is {given!r:.40}, needs a number above 0; record it again",
        )
    return float(given)


def _scaled(chunk: Chunk, resolution: float) -> Float32Array:
    with np.errstate(over="ignore"):  # of a count that is as large as no distance is
        return (chunk.image() * resolution).astype(np.float32)


def _amplitude(chunk: Chunk | None, info: TofInfo | None) -> Float32Array | None:
    """Return amplitudes from their square roots: (count - 1) squared times the resolution; -1 for none."""
    if chunk is None:
        return None
    of_info = None if info is None else info.amplitude_resolution
    resolution = _resolution(chunk, "AmplitudeResolution", of_info)
    root = chunk.image().astype(np.float64) - 1.0
    with np.errstate(over="ignore"):
        return np.where(root >= 0.0, root * root * resolution, -1.0).astype(np.float32)


def _bits(chunk: Chunk | None) -> NDArray[Any] | None:
    """Return an image of bits. Raises ``RecordingError`` if its pixels are no integers."""
    image = None if chunk is None else chunk.image()
    if image is not None and image.dtype.kind not in "iu":
        raise RecordingError(
            "buffer", f"image {CONFIDENCE} (confidence) is {image.dtype}, needs integers; record it again"
        )
    return image


class FrameMaker:
    """Makes frames of images: z-depth, validity and noise, with the lens found once."""

    def __init__(self, calibration: Camera | None) -> None:
        self._calibration = calibration
        self._lens: tuple[object, Camera, Float32Array] | None = None

    def frame(self, images: IfmImages, stamp_ns: int) -> PmdFrame:
        """Return a frame.

        The head's distances and their noise are radial; the frame has their components along the boresight.
        Pixels that the confidence refuses have neither.

        Raises:
            TofInfoError: the lens is not known, or not for this size.
        """
        camera, cosines = self._lens_of(images)
        valid = images.range_m > 0.0
        if images.confidence is not None:
            valid &= (images.confidence & _INVALID) == 0
        nan = np.float32(np.nan)
        sigma_m = images.sigma_m
        return PmdFrame(
            stamp_ns=stamp_ns,
            frame_id="",
            depth_m=np.where(valid, images.range_m * cosines, nan),
            amplitude=images.amplitude,
            camera=camera,
            depth_sigma_m=None if sigma_m is None else np.where(valid, sigma_m * cosines, nan),
        )

    def _lens_of(self, images: IfmImages) -> tuple[Camera, Float32Array]:
        height, width = images.range_m.shape
        info = images.tof_info
        known = (info and info.intrinsic, images.range_m.shape)
        if self._lens is None or self._lens[0] != known:
            camera, cosines = self._found(info, images.problem, (height, width))
            self._lens = known, camera, cosines.astype(np.float32)
        return self._lens[1:]

    def _found(
        self, info: TofInfo | None, problem: str, size: tuple[int, int]
    ) -> tuple[Camera, NDArray[np.float64]]:
        height, width = size
        given = self._calibration
        if given is not None:
            if (given.height, given.width) != size:
                raise TofInfoError(
                    f"device.calibration is for {given.width} x {given.height} pixels, the head sends "
                    f"{width} x {height}; calibrate it in this mode"
                )
            return given, ray_cosines(given)
        if info is None:
            raise TofInfoError(problem)
        return info.camera(width, height), info.cosines(width, height)
