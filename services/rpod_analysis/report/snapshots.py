"""Sample frames of a run, overlaid with the target's wireframe at the estimate and at the truth."""

import base64
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_analysis.log import Log
from rpod_analysis.log.sensors import Sensor, lidar_info, sensor_frames
from rpod_analysis.report.plot_data import PlotData
from rpod_analysis.report.wireframe import svg_path
from rpod_analysis.scoring.run import Run, StreamedRun
from rpod_analysis.scoring.score import Track, interpolate
from rpod_geometry.rays import RayGrid
from rpod_geometry.wireframe import project, visible_pieces
from rpod_runtime.sensor_data.scan_grid import ahead
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.messages import read_image, read_stamp
from rpod_schemas.topics import CONTRADICTION
from rpod_schemas.types import Camera, Float32Array, FrameImage, LidarInfo, SensorFrame
from rpod_target import Target

_SAMPLES = 4
"""Number of frames of each sensor that are shown."""
_SLICE_NS = 200_000_000
"""Greatest time between the arrivals of a frame's parts, ns."""
_ASPECT = 4.0 / 3.0
_MARGIN = 1.25
_MOST_POINTS = 4000
_SHADES = 10
_LEAST_SIDE, _MOST_SIDE = 2.0, 20.0
"""Least and greatest side of a square at a marked ray, in thousandths."""


@dataclass(frozen=True)
class Picture:
    """One image with its overlay; coordinates are a camera's pixels, or x/z and y/z in thousandths."""

    title: str
    view: tuple[float, float, float, float]
    """Window of the picture: left, top, width, height."""
    image: str
    """Image as a data URI; empty if points are drawn."""
    size: tuple[int, int]
    """Width and height of the image."""
    points: tuple[tuple[str, str], ...]
    """Colour and SVG path of points, from near to far."""
    low: str
    high: str
    """Labels of the ends of the scale."""
    scale: str
    """Name of the scale: ``depth`` or ``grey``."""


@dataclass(frozen=True)
class Snapshot:
    """A frame of a sensor at a time."""

    sensor: str
    time_s: float
    note: str
    pictures: tuple[Picture, ...]
    estimate_path: str
    """SVG path of the wireframe at the estimate; empty if there is none."""
    truth_path: str
    marks_path: str = ""
    """SVG path of the pixels or rays that contradict the pose; empty if there are none."""


class Wireframes(NamedTuple):
    """Targets whose wireframes are drawn; None where it is not known."""

    model: Target | None
    """Drawn at the estimate."""
    truth: Target | None
    """Drawn at the truth."""


def take_snapshots(log: Log, run: StreamedRun, plot_data: PlotData, wireframes: Wireframes) -> list[Snapshot]:
    """Return about four frames of each sensor, spread over the run, preferably frames with an estimate."""
    return [
        snapshot
        for sensor in run.sensors.values()
        for stamp_ns in _sample_stamps(plot_data, sensor)
        for frame in _read_frame(log, run.at(stamp_ns), sensor, stamp_ns)
        if (snapshot := _snapshot(run.at(stamp_ns), sensor, frame, wireframes))
    ]


def take_refused(log: Log, run: StreamedRun, wireframes: Wireframes) -> list[Snapshot]:
    """Return about four frames that were refused for pixels or rays, spread over the run, with these."""
    topic = CONTRADICTION.under(run.prefix).name
    arrivals_ns = [logged.log_ns for logged in log.messages(topic)]
    places = np.linspace(0, len(arrivals_ns) - 1, min(_SAMPLES, len(arrivals_ns))).astype(np.int64)
    shown = []
    for log_ns in dict.fromkeys(arrivals_ns[place] for place in places):
        for logged in log.messages(topic, start_ns=log_ns, end_ns=log_ns + 1):
            with log.unreadable.left_out(logged):
                message = logged.decode()
                stamp_ns, frame_id = read_stamp(message.header), str(message.header.frame_id)
                marks = _Marks(stamp_ns, frame_id, read_image(message))
                shown += [_refused(log, run, wireframes, marks)]
    return [snapshot for snapshots in shown for snapshot in snapshots]


class _Marks(NamedTuple):
    """Marked pixels or rays of the frame with a stamp and a frame of reference."""

    stamp_ns: int
    frame_id: str
    marked: Array


def _refused(log: Log, run: StreamedRun, wireframes: Wireframes, marks: _Marks) -> list[Snapshot]:
    """Return the frame that was refused for the marked pixels or rays."""
    part = run.at(marks.stamp_ns)
    return [
        replace(
            snapshot,
            note=_refusal(part, marks.stamp_ns, sensor.name),
            marks_path=_marks_path(marks.marked, frame.lens)
            if frame.lens is not None
            else _ray_marks_path(marks.marked, frame, lidar_info(log, sensor.name)),
        )
        for sensor in run.sensors.values()
        if marks.stamp_ns in part.frames[sensor.name].stamp_ns
        for frame in _read_frame(log, part, sensor, marks.stamp_ns)
        if frame.frame_id == marks.frame_id and (snapshot := _snapshot(part, sensor, frame, wireframes))
    ]


def _refusal(run: Run, stamp_ns: int, sensor: str) -> str:
    """Return the reason in the status of a sensor's frame."""
    mine = (run.statuses.stamp_ns == stamp_ns) & (run.statuses.sensor == sensor)
    reasons = run.statuses.reason[mine]
    return str(reasons[0]) if reasons.size else "refused"


def _marks_path(marked: Array, camera: Camera) -> str:
    """Return an SVG path of squares over the marked pixels of an image that covers the camera's image."""
    rows, columns = np.nonzero(marked)
    side = camera.width / marked.shape[1]
    squares = zip(side * columns - 0.5, side * rows - 0.5, strict=True)
    return "".join(f"M{x:.1f} {y:.1f}h{side:.1f}v{side:.1f}h-{side:.1f}z" for x, y in squares)


def _ray_marks_path(marked: Array, frame: SensorFrame, info: LidarInfo | None) -> str:
    """Return an SVG path of squares at the marked rays of a scan, in thousandths.

    The rays are those of the pattern that the sensor states; without one, only returns of an organised scan
    can be marked.

    Args:
        marked: rays, shape (rows, columns); rows are elevations.
        frame: the scan.
        info: what the sensor says of itself.
    """
    rays_m = _points_of(marked.shape, frame, info)
    if rays_m is None:
        return ""
    rays_m = rays_m[marked.astype(np.bool_)]
    rays_m = rays_m[np.isfinite(rays_m).all(axis=1) & (rays_m[:, 2] > 0.0)]
    if not len(rays_m):
        return ""
    centres = project(rays_m, None)
    steps = np.abs(np.diff(np.unique(centres[:, 0].round(2))))
    side = float(np.clip(np.median(steps), _LEAST_SIDE, _MOST_SIDE)) if steps.size else _LEAST_SIDE
    squares = centres - side / 2.0
    return "".join(f"M{x:.1f} {y:.1f}h{side:.1f}v{side:.1f}h-{side:.1f}z" for x, y in squares)


def _points_of(shape: tuple[int, ...], frame: SensorFrame, info: LidarInfo | None) -> Array | None:
    """Return a point on each ray of a scan, shape (rows, columns, 3), NaN or None where it is not known."""
    pattern = None if info is None else ahead(info)
    if pattern is not None and (pattern.elevation_rad.size, pattern.azimuth_rad.size) == shape:
        return RayGrid.azimuth_elevation(pattern.azimuth_rad, pattern.elevation_rad).directions
    grid_m = frame.grid_m
    return grid_m if grid_m is not None and grid_m.shape[:2] == shape else None


def _sample_stamps(plot_data: PlotData, sensor: Sensor) -> list[int]:
    estimated = plot_data.frames[sensor.name].stamp_ns
    choice = estimated if estimated.size else plot_data.any_frames[sensor.name].stamp_ns
    if not choice.size:
        return []
    places = np.quantile(np.arange(choice.size), np.linspace(0.02, 0.98, _SAMPLES), method="nearest")
    return [int(stamp_ns) for stamp_ns in choice[np.unique(places).astype(np.int64)]]


def _read_frame(log: Log, run: Run, sensor: Sensor, stamp_ns: int) -> Iterator[SensorFrame]:
    frames = run.frames[sensor.name]
    log_ns = int(frames.log_ns[np.argmax(frames.stamp_ns == stamp_ns)])
    slice_ns = {"start_ns": log_ns - _SLICE_NS, "end_ns": log_ns + _SLICE_NS}
    near = sensor_frames(log, sensor.name, sensor.kind, **slice_ns)
    yield from (frame for frame in near if frame.stamp_ns == stamp_ns)


def _snapshot(run: Run, sensor: Sensor, frame: SensorFrame, wireframes: Wireframes) -> Snapshot | None:
    camera = frame.lens
    index = _index_of(run.estimates, frame.stamp_ns)
    estimate = None if index is None else run.estimates.poses[index]
    drawn = [
        _outline(sensor, wireframes.model, camera, estimate),
        _outline(sensor, wireframes.truth, camera, _truth_at(run, frame.stamp_ns)),
    ]
    outline = np.concatenate([segments.reshape(-1, 2) for segments in drawn])
    return Snapshot(
        sensor=sensor.name,
        time_s=float(run.seconds(np.array([frame.stamp_ns]))[0]),
        note=_note(run, index),
        pictures=frame_pictures(frame, outline),
        estimate_path=svg_path(drawn[0]),
        truth_path=svg_path(drawn[1]),
    )


def _index_of(track: Track, stamp_ns: int) -> int | None:
    found = np.flatnonzero(track.stamp_ns == stamp_ns)
    return int(found[-1]) if found.size else None


def _truth_at(run: Run, stamp_ns: int) -> RigidTransform | None:
    poses, known = interpolate(run.truth, np.array([stamp_ns]))
    return poses[0] if known[0] else None


def _outline(
    sensor: Sensor, target: Target | None, camera: Camera | None, T_chaser_target: RigidTransform | None
) -> FloatArray:
    if target is None or T_chaser_target is None or sensor.T_chaser_sensor is None:
        return np.zeros((0, 2, 2))
    pieces = visible_pieces(target, sensor.T_chaser_sensor.inv() * T_chaser_target)
    return project(pieces, camera)


def _note(run: Run, index: int | None) -> str:
    if index is None:
        return "no estimate"
    if not run.errors.scored[index]:
        return "no truth"
    return f"{np.rad2deg(run.errors.angle_rad[index]):.2f}°, {1e3 * run.errors.distance_m[index]:.1f} mm"


def frame_pictures(frame: SensorFrame, outline: FloatArray) -> tuple[Picture, ...]:
    """Return the images of a frame, or its points, with a window around an outline, pixels, shape (N, 2)."""
    if not frame.images:
        return _points_pictures(frame.returns_m, outline)
    first = frame.images[0].values
    size = first.shape[1], first.shape[0]
    rows, columns = np.nonzero(np.isfinite(first))
    view = _view(outline if len(outline) else np.column_stack([columns, rows]).astype(np.float64), size)
    return tuple(_image_picture(image, view, size) for image in frame.images)


def _image_picture(
    image: FrameImage, view: tuple[float, float, float, float], size: tuple[int, int]
) -> Picture:
    values = image.values
    if image.scale == "grey":
        low, high = _span(values)
        grey = (255.0 * (_shade(values, low, high) / 255.0) ** 0.6).astype(np.uint8)
        return Picture(image.title, view, _data_uri(grey), size, (), f"{high:.0f}", f"{low:.0f}", "grey")
    known = np.isfinite(values)
    near, far = _span(values[known])
    opaque = np.where(known, 255, 0).astype(np.uint8)
    coloured = cv2.applyColorMap(_shade(values, far, near), cv2.COLORMAP_VIRIDIS)
    depth = np.dstack([coloured, opaque]).astype(np.uint8)
    return Picture(image.title, view, _data_uri(depth), size, (), f"{near:.2f} m", f"{far:.2f} m", "depth")


def _points_pictures(returns_m: Float32Array, outline: FloatArray) -> tuple[Picture, ...]:
    points = returns_m[:: len(returns_m) // _MOST_POINTS + 1].astype(np.float64)
    points = points[points[:, 2] > 0.0]
    if not len(points):
        return ()
    image = project(points, None)
    range_m = np.linalg.norm(points, axis=1)
    near, far = _span(range_m)
    shade = _shade(range_m, far, near) // (256 // _SHADES + 1)
    layers = []
    for level in range(_SHADES):
        colour = cv2.applyColorMap(
            np.array([[level * 255 // (_SHADES - 1)]], np.uint8), cv2.COLORMAP_VIRIDIS
        )[0, 0]
        path = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in image[shade == level])
        layers.append((f"rgb({colour[2]},{colour[1]},{colour[0]})", path))
    view = _view(np.concatenate([image, outline]), None)
    return (Picture("returns", view, "", (0, 0), tuple(layers), f"{near:.2f} m", f"{far:.2f} m", "depth"),)


def _view(points: FloatArray, size: tuple[int, int] | None) -> tuple[float, float, float, float]:
    """Return a window that contains points, with a margin, in the aspect ratio of the pictures."""
    if not len(points):
        return (0.0, 0.0, *size) if size else (0.0, 0.0, 1.0, 1.0)
    low, high = points.min(axis=0), points.max(axis=0)
    width, height = np.maximum((high - low) * _MARGIN, 1e-3)
    width, height = max(width, height * _ASPECT), max(height, width / _ASPECT)
    left, top = (low + high - (width, height)) / 2.0
    return float(left), float(top), float(width), float(height)


def _span(values: Array) -> tuple[float, float]:
    low, high = np.percentile(values, (1, 99))
    return float(low), float(max(high, low + 1e-6))


def _shade(values: Array, black: float, white: float) -> NDArray[np.uint8]:
    """Return values scaled to 0 to 255 between two limits; NaN gives 0."""
    share = np.nan_to_num((values.astype(np.float64) - black) / (white - black))
    return (255.0 * share.clip(0.0, 1.0)).astype(np.uint8)


def _data_uri(image: NDArray[np.uint8]) -> str:
    _, encoded = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, 92])
    return f"data:image/webp;base64,{base64.b64encode(encoded.tobytes()).decode()}"
