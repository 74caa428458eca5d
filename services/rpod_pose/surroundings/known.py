"""Knowledge of a sensor's surroundings: a range gate, a mask, and a background without the target.

The background is learned from frames without the target: for each pixel or ray, the median range and its
noise. Ranges that agree with it are not on the target. It is stored as arrays in an ``npz`` file.
"""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Self
from zipfile import BadZipFile, ZipFile

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_pose.errors import PoseError
from rpod_pose.surroundings.bodies import KnownBodies
from rpod_pose.surroundings.frames import Frames
from rpod_pose.surroundings.separation import Label
from rpod_schemas.arrays import MAD_TO_SIGMA
from rpod_schemas.bounds import IMAGE_PIXELS
from rpod_schemas.config.base import load
from rpod_schemas.config.surroundings import KnownSurroundings, SensorSurroundings
from rpod_schemas.types import Float32Array

LEAST_SEEN = 0.5
"""Least share of the frames in which a pixel must have a range to belong to the background. Hand: at a place
where a range is rarer, something else may be in front."""
SIGMAS = 4.0
"""Largest distance of a range from the background, in standard deviations, at which it agrees with it.
Physics: one in 16,000 normal errors is larger."""
RESOLUTION = 2e-3
"""Least standard deviation of a range, over the range. Hand: clocks and temperature drift."""
MOST_FRAMES = 200
"""Largest number of frames from which a background is learned; they are spread evenly over all frames.
Numerics: memory; a median is then known to a tenth of the noise."""


_MOST_BYTES = 2 * 8 * int(IMAGE_PIXELS.high)
"""Largest size of the two arrays of a background, of the largest image and of any numeric type. Numerics:
memory; a compressed file of some megabytes may hold a thousand times as much."""
_UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, MemoryError, BadZipFile, zlib.error)
"""Exceptions that NumPy raises on damaged files."""


class KnownSurroundingsError(PoseError):
    """The knowledge of a sensor's surroundings cannot be used."""


@dataclass(frozen=True, eq=False)
class Background:
    """Ranges without the target."""

    range_m: Float32Array
    """Median range of each pixel or ray, shape (rows, columns), 0 where there is none."""
    sigma_m: Float32Array
    """Standard deviation of a range, same shape."""
    frames: int = 0
    """Number of frames from which it was learned; 0 if it is unknown."""

    def __post_init__(self) -> None:
        """Check that both arrays are of one image."""
        if self.range_m.ndim != 2 or self.range_m.shape != self.sigma_m.shape:
            raise KnownSurroundingsError(
                f"range_m has the shape {self.range_m.shape}, sigma_m {self.sigma_m.shape}; both need the "
                "(rows, columns) of the sensor's frames"
            )

    @classmethod
    def learned(cls, ranges_m: Iterable[Float32Array]) -> Self:
        """Return the background of frames without the target, of which a limited number is kept at a time.

        Args:
            ranges_m: ranges of each frame, shape (rows, columns), 0 without one.

        Raises:
            KnownSurroundingsError: there is no frame, or frames differ in size.
        """
        kept, frames = _spread(ranges_m)
        every = np.stack(kept)
        every = np.where(every > 0.0, every, np.float32(np.nan))
        known = np.isfinite(every).mean(axis=0) >= LEAST_SEEN
        middle, spread = np.zeros(known.shape), np.zeros(known.shape)
        middle[known] = np.nanmedian(every[:, known], axis=0)
        spread[known] = MAD_TO_SIGMA * np.nanmedian(np.abs(every[:, known] - middle[known]), axis=0)
        return cls(middle.astype(np.float32), spread.astype(np.float32), frames)

    def write(self, path: Path) -> None:
        """Write the arrays to a file."""
        np.savez_compressed(path, range_m=self.range_m, sigma_m=self.sigma_m)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Return a background from a file.

        Raises:
            KnownSurroundingsError: the file cannot be read, or has no background.
        """
        try:
            with path.open("rb") as stream:
                _check_size(stream)
                with np.load(stream) as arrays:
                    return cls(arrays["range_m"], arrays["sigma_m"])
        except (*_UNREADABLE, KnownSurroundingsError) as error:
            raise KnownSurroundingsError(
                f"background {path} cannot be read: {error}; make it with 'rpod calibrate background'"
            ) from error

    def agrees(self, range_m: Float32Array) -> NDArray[np.bool_]:
        """Return which ranges, 0 without one, agree with the background."""
        sigma_m = np.maximum(self.sigma_m, RESOLUTION * self.range_m)
        close: NDArray[np.bool_] = np.abs(range_m - self.range_m) < SIGMAS * sigma_m
        return close & (self.range_m > 0.0) & (range_m > 0.0)


def _check_size(stream: BinaryIO) -> None:
    """Raise ``KnownSurroundingsError`` if a file's arrays are larger than those of a background can be."""
    with ZipFile(stream) as archive:
        size = sum(each.file_size for each in archive.infolist())
    if size > _MOST_BYTES:
        raise KnownSurroundingsError(f"it holds {size:,} bytes, a background has {_MOST_BYTES:,} at most")
    stream.seek(0)


def _spread(ranges_m: Iterable[Float32Array]) -> tuple[list[Float32Array], int]:
    """Return at most ``MOST_FRAMES`` frames, spread evenly over all, and the number of all.

    Raises:
        KnownSurroundingsError: there is no frame, or frames differ in size.
    """
    kept: list[Float32Array] = []
    number, step = -1, 1
    for number, range_m in enumerate(ranges_m):
        if kept and range_m.shape != kept[0].shape:
            sizes = " and ".join(_size(each) for each in (kept[0], range_m))
            raise KnownSurroundingsError(
                f"frames of {sizes} pixels: record all with one setting of the sensor"
            )
        if number % step == 0:
            kept.append(range_m)
        if len(kept) > MOST_FRAMES:
            kept, step = kept[::2], 2 * step
    if not kept:
        raise KnownSurroundingsError("no frames: record the sensor without the target")
    return kept, number + 1


def _size(image: NDArray[Any]) -> str:
    return " x ".join(map(str, image.shape[::-1]))


@dataclass(frozen=True, eq=False)
class KnownParts:
    """Known parts of a sensor's frames that cannot show the target."""

    frames: Frames[Any]
    gate_m: tuple[float, float]
    unused: NDArray[np.bool_] | None
    background: Background | None
    bodies: KnownBodies | None = None
    sensor: str = ""
    """Name of the sensor."""
    dead_rows: tuple[int, ...] = ()
    dead_columns: tuple[int, ...] = ()

    @classmethod
    def of(
        cls,
        known: SensorSurroundings,
        frames: Frames[Any],
        folder: Path,
        bodies: KnownBodies | None = None,
        *,
        sensor: str = "",
    ) -> Self:
        """Return the known parts of a sensor's frames; files are relative to a folder.

        Raises:
            KnownSurroundingsError: a file cannot be read.
        """
        unused = None
        if known.mask is not None:
            image = _grey_image(folder / known.mask)
            if image is None:
                raise KnownSurroundingsError(f"mask {folder / known.mask} is no image that can be read")
            unused = image == 0
        background = None if known.background is None else Background.read(folder / known.background)
        gate_m = known.range_gate_m or (0.0, np.inf)
        dead = known.dead_rows, known.dead_columns
        return cls(frames, gate_m, unused, background, bodies, sensor, *dead)

    def without(self, frame: Any) -> Any:
        """Return a frame without the parts that are known to be no target.

        Raises:
            KnownSurroundingsError: mask or background have another size than the frame.
        """
        range_m = self.frames.every_range_m(frame)
        labels = np.full(range_m.shape, Label.KEPT, np.uint8)
        measured, (near_m, far_m) = range_m > 0.0, self.gate_m
        labels[measured & (range_m > far_m)] = Label.BEYOND
        labels[measured & (range_m < near_m)] = Label.HIDING
        if self.background is not None:
            _require_size("background", self.background.range_m, range_m)
            labels[self.background.agrees(range_m)] = Label.BEYOND
        unused = self._unused(frame, range_m)
        if unused is not None:
            labels[unused] = Label.HIDING
        return self.frames.separated(frame, labels, np.zeros(labels.shape, np.bool_))

    def _unused(self, frame: Any, range_m: Float32Array) -> NDArray[np.bool_] | None:
        """Return the pixels or rays that are not used, shape (rows, columns); None if there are none."""
        if self.unused is not None:
            _require_size("mask", self.unused, range_m)
        if not (self.dead_rows or self.dead_columns):
            return self.unused
        if frame.range_image_m is None:
            raise KnownSurroundingsError(
                "dead_rows and dead_columns need scans of rows and columns; this one is a list of points: "
                "let the driver publish organised scans"
            )
        unused = np.zeros(range_m.shape, np.bool_) if self.unused is None else self.unused.copy()
        dead = ("dead_rows", self.dead_rows), ("dead_columns", self.dead_columns)
        for axis, (name, lines) in enumerate(dead):
            if lines and max(lines) >= unused.shape[axis]:
                raise KnownSurroundingsError(
                    f"{name} names {max(lines)}, the frame has {unused.shape[axis]}, counted from 0"
                )
            unused.swapaxes(0, axis)[list(lines)] = True
        return unused

    def of_target(self, frame: Any, stamp_ns: int, T_chaser_sensor: RigidTransform) -> Any:
        """Return a frame without the parts that are known to be no target, and without the known bodies.

        Args:
            frame: the frame.
            stamp_ns: stamp of the frame, for which the bodies' poses are used.
            T_chaser_sensor: mount of the sensor.

        Raises:
            KnownSurroundingsError: mask or background have another size than the frame.
        """
        left = self.without(frame)
        image = None if self.bodies is None else self.frames.image(frame, fine=True)
        if self.bodies is None or image is None:
            return left
        return self.frames.behind_bodies(
            left, self.bodies.hiding(image, stamp_ns, T_chaser_sensor, self.sensor)
        )


def _grey_image(path: Path) -> NDArray[Any] | None:
    """Return an image, shape (rows, columns); None if it cannot be read."""
    try:
        return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    except cv2.error:  # it is larger than OpenCV reads
        return None


def _require_size(name: str, known: NDArray[Any], range_m: Float32Array) -> None:
    if known.shape != range_m.shape:
        raise KnownSurroundingsError(f"the {name} has {_size(known)} pixels, the frame {_size(range_m)}")


def known_bodies(path: Path | None) -> KnownBodies | None:
    """Return the bodies that a file describes; None if none.

    Raises:
        rpod_schemas.errors.ConfigurationError: the file is wrong.
        KnownBodiesError: a file that it names cannot be read.
    """
    return None if path is None else KnownBodies.of(load(KnownSurroundings, path).bodies, path.parent)


def known_parts(
    path: Path, sensor: str, frames: Frames[Any] | None, bodies: KnownBodies | None = None
) -> KnownParts | None:
    """Return the known parts of a sensor from a file, with the known bodies; None if there are none.

    Raises:
        rpod_schemas.errors.ConfigurationError: the file is wrong.
        KnownSurroundingsError: a file that it names cannot be read, or the kind of sensor cannot use it.
    """
    known = load(KnownSurroundings, path).sensors.get(sensor)
    if known is None and bodies is None:
        return None
    if frames is None:
        raise KnownSurroundingsError(f"{sensor}: sensors of its kind have no known surroundings")
    return KnownParts.of(known or SensorSurroundings(), frames, path.parent, bodies, sensor=sensor)
