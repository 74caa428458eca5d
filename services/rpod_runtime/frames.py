"""Decodes and checks the parts of a complete frame.

A reader reads the messages of one sensor and keeps the sensor's info. A sensor kind names its reader; the
readers of the PMD camera and the LIDAR are here.
"""

import logging
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.errors import DistortionError
from rpod_geometry.lens import ray_cosines
from rpod_runtime.assembler import Assembled, Assembler
from rpod_runtime.delivery.inbox import Received
from rpod_runtime.sensor_data.codecs import decompressed
from rpod_runtime.sensor_data.empty_lines import EmptyLines
from rpod_runtime.sensor_data.exposure_watch import ExposureWatch
from rpod_runtime.sensor_data.scan_grid import (
    GridInference,
    ahead,
    angles_of,
    columns_ahead,
    is_ahead,
    rows_are_elevation,
)
from rpod_runtime.sensor_data.stated_directions import SIGNS, compared_directions
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import (
    NANOSECONDS,
    build,
    read_amplitude,
    read_camera,
    read_depth,
    read_lidar_info,
    read_pmd_info,
    read_points,
    time_field,
)
from rpod_schemas.messages.header import read_text
from rpod_schemas.registry import resolve
from rpod_schemas.sensors import SensorKind
from rpod_schemas.topics import COMPRESSED_IMAGE
from rpod_schemas.types import Camera, Float32Array, LidarInfo, LidarScan, PmdFrame, PmdInfo, SensorFrame

log = logging.getLogger(__name__)

ReadT = TypeVar("ReadT")

_HEADED_BYTES = 12
"""Size of a message's CDR header and stamp."""
_SETTLED = 10
"""Number of scans with the same orientation after which it counts as known: no driver changes it."""
_LEAST_PILE = 16
"""Least number of pixels with an image's largest value by which it counts as clipped."""
_PILED, _LEVELS = 5.0, 8
"""Least ratio of their number to that of pixels with each of the next lower values; number of such values."""
ICD = SourceConfig()
"""The source of a sensor that keeps to the interface control document."""


class SensorReader(Protocol):
    """Reads the messages of one sensor. It is created as ``(source)``, how the sensor's driver publishes.

    A reader inherits from this class, for the properties that it has no use for.
    """

    @property
    def newest_info(self) -> Any:
        """Info that describes the sensor; None as long as there is none."""
        return None

    @property
    def stated_info(self) -> Any:
        """The part of ``newest_info`` that the sensor has published, and that must not change in a track."""
        return self.newest_info

    @property
    def inconsistency(self) -> str:
        """How the messages of the sensor contradict each other; empty if they do not."""
        return ""

    @property
    def hint(self) -> str:
        """Fault in the newest frames that may be why they are refused; empty if there is none."""
        return ""

    def learn(self, message: Any) -> None:
        """Store the sensor's info, a decoded message. Raises ``MessageRejectedError``."""
        ...

    def read(self, frame: Assembled[Received]) -> SensorFrame:
        """Return a frame. Raises ``PartRejectedError``."""
        ...


def open_reader(kind: SensorKind, source: SourceConfig = ICD) -> SensorReader:
    """Return a new reader of a kind."""
    reader: SensorReader = resolve(kind.reader)(source)
    return reader


def assembler_of(kind: SensorKind, source: SourceConfig = ICD) -> Assembler[Any]:
    """Return an assembler of the frames of a kind (ICD section 2)."""
    optional = frozenset(name for name in kind.optional if source.topic(name, kind.leading) is not None)
    within_ns = round(source.pair_within_s * NANOSECONDS)
    return Assembler(kind.required, optional, kind.lasting, kind.leading_part, within_ns)


class PartRejectedError(MessageRejectedError):
    """A part of a frame cannot be used; ``topic`` is the topic on which it came."""

    def __init__(self, received: Received, rejection: MessageRejectedError) -> None:
        super().__init__(rejection.reason, rejection.text)
        self.topic = received.topic.name


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


class LidarReader(SensorReader):
    """Reads the scans of a LIDAR; each row of a scan has one elevation."""

    def __init__(self, source: SourceConfig = ICD) -> None:
        self._source = source
        self._info: LidarInfo | None = None
        self._inferred = GridInference()
        self._whole: LidarInfo | None = None
        self._front: LidarInfo | None = None
        self._seen_rows = True
        self._shown = self._compared = 0
        self._empty = EmptyLines()
        self._inconsistencies: dict[str, str] = {}
        self._logged: set[str] = set()

    @property
    def inconsistency(self) -> str:
        """How info and points of the LIDAR contradict each other; empty if they do not."""
        return "; ".join(self._inconsistencies.values())

    @property
    def hint(self) -> str:
        """Fault in its scans that may be why they are refused; empty if there is none."""
        return self._empty.text

    @property
    def newest_info(self) -> LidarInfo | None:
        """Info that the LIDAR published, else the scan pattern that its points show; only the part ahead."""
        pattern = self._info or self._inferred.pattern
        if pattern is not self._whole:
            self._whole, self._front = pattern, None if pattern is None else ahead(pattern)
        return self._front

    @property
    def stated_info(self) -> LidarInfo | None:
        """Info that the LIDAR published; None if the pattern is inferred, which changes as more is seen."""
        return None if self._info is None else self.newest_info

    def learn(self, message: Any) -> None:
        """Store the latched info, if it holds a scan pattern."""
        info = read_lidar_info(message)
        if info.azimuth_rad.size and info.elevation_rad.size:
            self._info = info
            self._inconsistencies.clear()
            self._compared = 0

    def read(self, frame: Assembled[Received]) -> LidarScan:
        """Return a scan."""
        scan = read_part(frame.parts["points"], lambda message: self._scan(frame.stamp_ns, message))
        if self._info is None:
            time_s = np.zeros(1) if scan.time_s is None else scan.time_s[np.isfinite(scan.time_s)]
            self._inferred.add(scan.points_m, float(np.ptp(time_s)) if time_s.size else 0.0)
        front = self.newest_info
        if self._whole is not None and not (scan.organised and front is self._whole):
            scan = _ahead_of(scan, self._whole)
        if scan.organised:
            self._empty.add(scan.points_m)
        return scan

    def _scan(self, stamp_ns: int, message: Any) -> LidarScan:
        fields = read_points(message)
        item = time_field(message)
        if item is not None and "t" not in fields:
            self._note(
                "times",
                f"point field {item.name!r} is neither time from the stamp nor absolute time: ignored, "
                "so that a scan counts as measured at once; send seconds from the stamp as float32 t",
            )
        x_m, y_m, z_m = fields["x"], fields["y"], fields["z"]
        axes = (-y_m, -z_m, x_m) if self._source.axes == "forward" else (x_m, y_m, z_m)
        points_m = np.stack(axes, axis=-1)
        time_s = fields.get("t")
        if time_s is not None and self._source.to_middle_s:
            time_s = time_s - np.float32(self._source.to_middle_s)
        intensity = fields.get("intensity")
        if points_m.ndim == 3 and not self._rows_are_elevation(points_m):
            points_m = points_m.transpose(1, 0, 2)
            intensity, time_s = (None if each is None else each.T for each in (intensity, time_s))
        if points_m.ndim == 3:
            self._compare(points_m)
            points_m, (intensity, time_s) = self._in_order(points_m, (intensity, time_s))
        return build(
            LidarScan,
            stamp_ns=stamp_ns,
            frame_id=message.header.frame_id,
            points_m=_finite(points_m),
            intensity=intensity,
            time_s=time_s,
        )

    def _in_order(
        self, points_m: Float32Array, others: tuple[Float32Array | None, ...]
    ) -> tuple[Float32Array, tuple[Float32Array | None, ...]]:
        """Return the points of a scan and its other images with its rows in order."""
        self._inferred.learn_rows(points_m)
        if self._info is None:
            in_order = self._inferred.in_order
            return in_order(points_m), tuple(None if each is None else in_order(each) for each in others)
        if aside_rad := self._inferred.aside_rad:
            self._note(
                "rows",
                f"rows are up to {np.degrees(aside_rad):.1f} deg beside the columns of the info, so that "
                "a missing return counts for the wrong ray; let the driver destagger its rows and give "
                "points in the sensor's own axes, or publish no info",
            )
        return points_m, others

    def _compare(self, points_m: Float32Array) -> None:
        """Compare rows and columns of a scan, and their directions, with those of the published info."""
        if self._info is None:
            return
        rows, columns = points_m.shape[:2]
        stated = self._info.elevation_rad.size, self._info.azimuth_rad.size
        if (rows, columns) != stated:
            self._note(
                "size",
                f"scans have {rows} x {columns} points, elevations by azimuths, the info states "
                f"{stated[0]} x {stated[1]}; let the driver publish the info of its scan mode",
            )
        elif self._compared < _SETTLED:
            found = compared_directions(points_m, self._info)
            self._compared += bool(found)
            for name in (each.name for each in found if each.slope < 0.0):
                self._note(
                    name,
                    f"{name}_rad of the info runs the other way than the points, so that no pose fits: let "
                    f"the driver turn its sign; {SIGNS}",
                )

    def _rows_are_elevation(self, points_m: Float32Array) -> bool:
        """Return the orientation that the points show, else that of the info or of scans before."""
        if self._shown >= _SETTLED:
            return self._seen_rows
        seen = rows_are_elevation(points_m)
        stated = None if self._info is None else self._info.rows_are_elevation
        if seen is None:
            return self._seen_rows if stated is None else stated
        if stated not in (None, seen):
            self._note(
                "turned",
                f"info says rows_are_elevation: {stated}, but the points show {seen}, which is used; are "
                "azimuth and elevation, or the axes of the points, exchanged?",
            )
        self._shown = self._shown + 1 if seen == self._seen_rows else 1
        self._seen_rows = seen
        return seen

    def _note(self, about: str, text: str) -> None:
        """Keep an inconsistency of info and points until another info comes, and log it once."""
        self._inconsistencies.setdefault(about, text)
        if about not in self._logged:
            self._logged.add(about)
            log.warning("%s", text)


def _ahead_of(scan: LidarScan, pattern: LidarInfo) -> LidarScan:
    """Return a scan without the directions that are not ahead."""
    if scan.organised and scan.points_m.shape[1] == pattern.azimuth_rad.size:
        kept: Any = (slice(None), columns_ahead(pattern.azimuth_rad))
    else:
        kept = is_ahead(angles_of(scan.points_m)[0])
    parts = {"points_m": scan.points_m, "intensity": scan.intensity, "time_s": scan.time_s}
    return scan.model_copy(update={name: part[kept] for name, part in parts.items() if part is not None})


def read_part(received: Received, read: Callable[[Any], ReadT]) -> ReadT:
    """Return the result of ``read`` for the decoded part. Raises ``PartRejectedError`` if it is refused."""
    try:
        return read(received.decode())
    except MessageRejectedError as error:
        raise PartRejectedError(received, error) from error


_OTHER_SIZE = {
    "depth": "let its driver send the camera_info of the depth image, as it is scaled or cropped",
    "amplitude": (
        "let its driver send one of the size of the depth image, pixel for pixel, or leave amplitude out of "
        "source.topics"
    ),
}
"""Remedy for an image of another size."""


def sized(image: Any, size: tuple[int, int], name: str = "") -> Any:
    """Return the image if its shape is ``size``, (height, width); else raise ``MessageRejectedError``.

    ``name`` is that of the image in the message, "depth" or "amplitude".
    """
    if image.shape != size:
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"{f'the {name} image' if name else 'image'} is {image.shape[1]} x {image.shape[0]} pixels, "
            f"camera_info says {size[1]} x {size[0]}; {_OTHER_SIZE.get(name, 'correct the driver')}",
        )
    return image


def _finite(points_m: Float32Array) -> Float32Array:
    if not np.isfinite(points_m).all(axis=-1).any():
        raise MessageRejectedError(Reason.NOT_FINITE, "no point of the cloud is finite")
    return points_m
