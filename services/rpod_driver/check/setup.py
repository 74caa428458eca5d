"""Lines about a sensor's description: axes, scan pattern, times of points, lens, mount, QoS."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_driver.check.observations import Observations, Offer
from rpod_driver.check.result import CheckResult, fail, note, ok, unchecked
from rpod_runtime.errors import ExtrinsicsError
from rpod_runtime.sensor_data.extrinsics import MOST_LINKS, in_words
from rpod_runtime.sensor_data.scan_grid import rows_are_elevation
from rpod_runtime.sensor_data.stated_directions import SIGNS, compared_directions
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.topics import CHASER, TF_STATIC
from rpod_schemas.types import LidarInfo, LidarScan, SensorInfo

_FULL_TURN = 0.9
"""Length of the mean direction below which a scanner looks all around."""
_SLOPE, _OFFSET_STEPS = 0.05, 0.5
"""Greatest deviation of measured from stated directions, relative to the spacing and in steps; half a step is
another ray."""
_CENTRE_SHARE = 0.25
"""Distance of the principal point from the middle, over the image's size; real ones have a few percent."""
_TIME_SHARES = (0.05, 1.2)
"""Time between the first and the last point over the scan time; the target alone fills a part of a scan."""


def _scans(seen: Observations) -> list[LidarScan]:
    return [kept.frame for kept in seen.kept if isinstance(kept.frame, LidarScan)]


def axes(seen: Observations) -> CheckResult:
    """Check whether points have z along the boresight, by where they lie or by the axis of a turning head."""
    line = "axes"
    scans = [scan for scan in _scans(seen) if len(scan.returns_m)]
    if not scans:
        return unchecked(line, "only of scans with returns")
    points_m = np.concatenate([scan.returns_m for scan in scans[:10]]).astype(np.float64)
    directions = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
    mean = directions.mean(axis=0)
    if np.linalg.norm(mean) > _FULL_TURN or mean[np.abs(mean).argmax()] > 0.6:
        forward = int(np.abs(mean).argmax()) == 0
        text = f"points lie around ({mean[0]:.2f}, {mean[1]:.2f}, {mean[2]:.2f})"
    else:
        spread = directions.std(axis=0)
        forward = int(spread.argmin()) == 2
        text = f"points spread by ({spread[0]:.2f}, {spread[1]:.2f}, {spread[2]:.2f})"
    return fail(line, text, "forward_axes") if forward else ok(line, f"{text}, z along the boresight")


def mirrored(seen: Observations) -> CheckResult:  # noqa: ARG001 - as of all lines
    """Return the line ``grid`` of a sensor without a scan pattern."""
    return unchecked("grid", "a mirrored image shows only against truth: give --target")


def grid(seen: Observations) -> CheckResult:
    """Check a scan's rows and columns against the pattern that its info states."""
    line = "grid"
    info = seen.info
    raws = [kept.raw for kept in seen.kept if kept.raw.ndim == 3]
    if not isinstance(info, LidarInfo) or not raws:
        return unchecked(line, "the sensor states no pattern, or its scans have no rows and columns")
    raw = max(raws, key=lambda points: np.count_nonzero(np.isfinite(points[..., 0])))
    upright = rows_are_elevation(raw)
    if upright is None:
        return unchecked(line, "the scans have too few returns to show rows and columns")
    if upright != info.rows_are_elevation:
        return fail(
            line, f"rows_are_elevation is {info.rows_are_elevation}, the points show {upright}", "transposed"
        )
    if not upright:
        raw = raw.transpose(1, 0, 2)
    size = (info.elevation_rad.size, info.azimuth_rad.size)
    if raw.shape[:2] != size:
        text = f"scans have {raw.shape[0]} x {raw.shape[1]} points, the info {size[0]} x {size[1]}"
        return fail(line, text, "wrong_pattern", "partial")
    return _pattern(raw, info)


def _pattern(raw: NDArray[Any], info: LidarInfo) -> CheckResult:
    """Check the directions of the points of a scan, shape (rows, columns, 3), against the stated ones."""
    figures: dict[str, float] = {}
    for name, slope, offset_steps in compared_directions(raw, info):
        figures |= {f"{name}_scale": slope, f"{name}_offset_steps": offset_steps}
        if slope < 0.0:
            text = f"{name} runs the other way than the info states; {SIGNS}"
            return fail("grid", text, "mirrored", "wrong_pattern", **figures)
    text = ", ".join(f"{name} {value:.3f}" for name, value in figures.items())
    off = any(abs(value - 1.0) > _SLOPE for name, value in figures.items() if name.endswith("scale"))
    off |= any(abs(value) > _OFFSET_STEPS for name, value in figures.items() if name.endswith("steps"))
    return fail("grid", text, "wrong_pattern", **figures) if off else ok("grid", text, **figures)


def point_times(seen: Observations) -> CheckResult:
    """Check the times of points against the scan time that the info states."""
    line = "point_times"
    scans, info = _scans(seen), seen.info
    scan_s = info.duration_s if isinstance(info, SensorInfo) else 0.0
    refused = [text for _, text in seen.refused if text.startswith("t ")]
    if refused:
        return fail(line, refused[0], "point_time_unit")
    if not scans or not scan_s:
        return unchecked(line, "the sensor states no scan time, or takes all points at once")
    timed = [scan.time_s for scan in scans if scan.time_s is not None]
    if not timed:
        return fail(line, f"a scan takes {1e3 * scan_s:.1f} ms, but points have no times", "no_point_times")
    spans_s = [float(np.ptp(time_s[np.isfinite(time_s)])) for time_s in timed if np.isfinite(time_s).any()]
    share = float(np.max(spans_s)) / scan_s if spans_s else 0.0
    text = f"points span {1e3 * share * scan_s:.2f} ms of a scan of {1e3 * scan_s:.2f} ms"
    low, high = _TIME_SHARES
    if not low <= share <= high:
        return fail(line, text, "point_time_unit", span_share=share)
    return ok(line, text, span_share=share)


def instant(seen: Observations) -> CheckResult:
    """Check to which instant of a scan its stamp refers, by the times of its points."""
    line = "instant"
    scans, info = _scans(seen), seen.info
    timed = [scan.time_s for scan in scans if scan.time_s is not None and np.isfinite(scan.time_s).any()]
    scan_s = info.duration_s if isinstance(info, SensorInfo) else 0.0
    if not timed or not scan_s:
        return unchecked(line, "start or middle shows only against truth: give --target")
    lows, highs = zip(*((np.nanmin(time_s), np.nanmax(time_s)) for time_s in timed), strict=True)
    low_s, high_s = float(np.min(lows)), float(np.max(highs))
    middle = 0.5 * (low_s + high_s) / scan_s
    text = f"points are from {1e3 * low_s:+.2f} to {1e3 * high_s:+.2f} ms of the stamp"
    if high_s - low_s < 0.5 * scan_s:
        return unchecked(line, f"{text}, too small a part of the scan; fill the field of view")
    if abs(middle) > 0.25:
        return fail(line, text, "stamp_start", middle_share=middle)
    return ok(line, text, middle_share=middle)


def lens(seen: Observations) -> CheckResult:
    """Check the lens by itself, and whether it stays."""
    line = "lens"
    if not seen.cameras:
        return unchecked(line, "no camera_info came")
    camera = seen.cameras[0]
    text = (
        f"fx {camera.fx:.2f}, fy {camera.fy:.2f}, centre ({camera.cx:.1f}, {camera.cy:.1f}) "
        f"of {camera.width} x {camera.height}"
    )
    if len(seen.cameras) > 1:
        return fail(line, f"{text}; it changed {len(seen.cameras) - 1} times", "lens_changes")
    off = (
        (camera.cx - (camera.width - 1) / 2.0) / camera.width,
        (camera.cy - (camera.height - 1) / 2.0) / camera.height,
    )
    if max(map(abs, off)) > _CENTRE_SHARE:
        return fail(line, f"{text}: the centre is far from the middle of the image", "lens_unscaled")
    return ok(line, text, fx=camera.fx, fy=camera.fy)


def mount(seen: Observations) -> CheckResult:
    """Check whether one chain of transforms leads from the sensor to the chaser."""
    line = "mount"
    if not seen.frame_ids:
        return unchecked(line, "no frame could be read")
    extrinsics, places = seen.extrinsics(), []
    for frame_id in sorted(seen.frame_ids):
        if rivals := extrinsics.rivals(frame_id):
            text = f"{rivals[0]} and {rivals[1]} put {frame_id!r} at different places"
            return fail(line, text, "second_mount")
        try:
            pose = extrinsics.mount(seen.name, frame_id)
        except ExtrinsicsError as error:
            return fail(line, str(error), "no_mount")
        places.append(f"{frame_id!r} is {in_words(seen.options.source.boresight_mount(pose))}")
    return ok(line, ", ".join(places))


def qos(seen: Observations) -> CheckResult:
    """Check whether latched topics are latched, by the tokens of their publishers."""
    line = "qos"
    came = {TF_STATIC.name: seen.mounts, f"{seen.name}/info": seen.infos}
    latched = list(came)
    parts = sensor_kind(seen.kind).part_topics(seen.name, seen.options.source).values()
    names = {*latched, *(topic.name for topic in parts)} & seen.qos.keys()
    own = {name: offers for name in names if (offers := _of_sensor(seen, name))}
    if not own.keys() - {TF_STATIC.name}:
        return unchecked(line, "no token of its publishers came")
    for topic in latched:
        for offer in own.get(topic, ()):
            if offer.qos.split(":")[1:2] != ["1"]:
                return fail(line, f"{topic} is not TRANSIENT_LOCAL", "not_latched")
    if untold := [topic for topic in latched if came[topic] and topic not in seen.qos]:
        return unchecked(line, f"no token of the publisher of {' and '.join(untold)} came; watch again")
    best_effort = [topic for topic in sorted(own) if any(each.qos.startswith("2") for each in own[topic])]
    if best_effort:
        return note(line, f"{', '.join(best_effort)} is BEST_EFFORT: a slow link loses messages")
    return ok(line, f"{len(own)} topics")


def _of_sensor(seen: Observations, topic: str) -> set[Offer]:
    """Return the offers of a topic that concern the sensor: many nodes publish ``tf_static``.

    Of those it is its own publisher's, and those of the publishers whose transforms lead from the sensor to
    the chaser; all, if none do, since a volatile publisher may be why.
    """
    offers = seen.qos[topic]
    if topic != TF_STATIC.name:
        return offers
    frames, links = set(seen.frame_ids), [(child, parent) for _, parent, child, _ in seen.mounts]
    for _ in range(MOST_LINKS):
        frames |= {parent for child, parent in links if child in frames}
    if CHASER not in frames:
        return offers
    given = {peer.session for peer, _, child, _ in seen.mounts if child in frames}
    return {each for each in offers if each.session in {"", *seen.sessions, *given}}
