"""The reader of a LIDAR: points of a scan, in the order of its pattern."""

import logging
from typing import Any

import numpy as np

from rpod_runtime.assembler import Assembled
from rpod_runtime.delivery.inbox import Received
from rpod_runtime.frames import ICD, SensorReader, read_part
from rpod_runtime.sensor_data.empty_lines import EmptyLines
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
from rpod_schemas.messages import build, read_lidar_info, read_points, time_field
from rpod_schemas.types import Float32Array, LidarInfo, LidarScan

log = logging.getLogger(__name__)

_SETTLED = 10
"""Number of scans with the same orientation after which it counts as known: no driver changes it."""


class LidarReader(SensorReader):
    """Reads the scans of a LIDAR; each row of a scan has one elevation."""

    def __init__(self, source: SourceConfig = ICD) -> None:
        self._source = source
        self._published: LidarInfo | None = None
        self._configured: LidarInfo | None = None
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
        """Scan pattern, only the part ahead: published, else configured, else as the points show it."""
        pattern = self._info or self._inferred.pattern
        if pattern is not self._whole:
            self._whole, self._front = pattern, None if pattern is None else ahead(pattern)
        return self._front

    @property
    def stated_info(self) -> LidarInfo | None:
        """Info that the LIDAR published; None if it published none. An inferred pattern may change."""
        return None if self._published is None else self.newest_info

    @property
    def _info(self) -> LidarInfo | None:
        """Scan pattern that is stated, by the LIDAR or else by the configuration."""
        return self._published or self._configured

    @property
    def _origin(self) -> str:
        """What states the scan pattern."""
        return "the configuration" if self._published is None else "the info"

    def assume(self, info: LidarInfo | None) -> None:
        """Store the configured scan pattern."""
        self._configured = info

    def learn(self, message: Any) -> None:
        """Store the latched info, if it holds a scan pattern."""
        info = read_lidar_info(message)
        if info.azimuth_rad.size and info.elevation_rad.size:
            self._published = info
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
                f"rows are up to {np.degrees(aside_rad):.1f} deg beside the columns of {self._origin}, so "
                "that a missing return counts for the wrong ray; let the driver destagger its rows and give "
                "points in the sensor's own axes, or state no pattern, which is then inferred",
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
                f"scans have {rows} x {columns} points, elevations by azimuths, {self._origin} states "
                f"{stated[0]} x {stated[1]}; state the pattern of the driver's scan mode",
            )
        elif self._compared < _SETTLED:
            found = compared_directions(points_m, self._info)
            self._compared += bool(found)
            for name in (each.name for each in found if each.slope < 0.0):
                self._note(
                    name,
                    f"{name}_rad of {self._origin} runs the other way than the points, so that no pose fits: "
                    f"turn its sign; {SIGNS}",
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


def _finite(points_m: Float32Array) -> Float32Array:
    if not np.isfinite(points_m).all(axis=-1).any():
        raise MessageRejectedError(Reason.NOT_FINITE, "no point of the cloud is finite")
    return points_m
