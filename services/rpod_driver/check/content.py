"""Lines about the content of images and points."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_driver.check.observations import Kept, Observations, middle_m
from rpod_driver.check.result import CheckResult, fail, note, ok, unchecked
from rpod_runtime.sensor_data.empty_lines import EmptyLines
from rpod_runtime.sensor_data.exposure_watch import LEAST_VOTES, summed, votes
from rpod_runtime.sensor_data.scan_grid import angles_of
from rpod_schemas.errors import Reason
from rpod_schemas.types import PmdFrame

_NEAR_M = 0.01
_SATURATED_SHARE = 0.1
"""Share of the lit pixels that may be saturated: a glint, not an exposure."""
_IMAGE_BINS, _SCAN_BINS, _LEAST_POINTS = 24, 12, 4
"""Number of blocks along each side of an image, and of a scan; number of returns of a full block."""
_FLICKER_SHARE = 0.2
"""Share of a frame's full blocks that may be empty in the next frame: a moving target uncovers edges."""
_ROWS_SHARE = 0.15
_CUT_SHARE = 0.04
"""Share of cut frames up to which there is no fault: single lost packets, which do not affect a track."""
_EMPTY = (Reason.NOT_FINITE, Reason.EMPTY)


def content(seen: Observations) -> CheckResult:
    """Check whether the frames can be read."""
    line = "content"
    if not seen.frames:
        return unchecked(line, "no frame is complete")
    refused = [(reason, text) for reason, text in seen.refused if reason not in _EMPTY]
    if refused:
        reason, text = Counter(refused).most_common(1)[0][0]
        names = {Reason.WRONG_SIZE: "wrong_size", Reason.WRONG_TYPE: "wrong_encoding"}
        faults = [names[reason]] if reason in names else []
        return fail(line, f"{len(refused)} frames cannot be read: {text}", *faults)
    text = f"{len(seen.kept)} of {seen.frames} frames read"
    if seen.refused_beside:
        why = Counter(text for _, text in seen.refused_beside).most_common(1)[0][0]
        return note(line, f"{text}; {len(seen.refused_beside)} messages beside them cannot be read: {why}")
    return ok(line, text)


def frozen(seen: Observations) -> CheckResult:
    """Check whether content repeats under another stamp: noise never repeats to the bit."""
    line = "frozen"
    blank = not any(each.frame.returns_m.size or _has_depth(each) for each in seen.kept)
    if len(seen.leads) < 2 or blank:
        return unchecked(line, "fewer than two frames with returns came")
    stamps_ns: dict[bytes, set[int]] = {}
    for heard in seen.leads:
        stamps_ns.setdefault(heard.digest, set()).add(heard.stamp_ns)
    again = sum(len(stamps) - 1 for stamps in stamps_ns.values())
    text = f"{again} of {len(seen.leads)} frames are identical to another frame to the bit"
    return fail(line, text, "frozen", repeated_share=again / len(seen.leads)) if again else ok(line, text)


def _has_depth(kept: Kept) -> bool:
    depth_m = getattr(kept.frame, "depth_m", None)
    return depth_m is not None and bool(np.isfinite(depth_m).any())


def _pairs(seen: Observations) -> Iterator[tuple[Kept, Kept]]:
    """Yield each pair of successive frames, in both orders."""
    for earlier, later in pairwise(seen.kept):
        if later.number == earlier.number + 1:
            yield earlier, later
            yield later, earlier


def returns(seen: Observations) -> CheckResult:
    """Check whether there are returns, and whether whole blocks of them come and go."""
    line = "returns"
    empty = sum(reason in _EMPTY for reason, _ in seen.refused)
    filled = [kept for kept in seen.kept if kept.frame.returns_m.size or _has_depth(kept)]
    frames = len(seen.kept) + empty
    if not frames:
        return unchecked(line, "no frame could be read")
    if len(filled) < 0.5 * frames:
        return fail(line, f"{frames - len(filled)} of {frames} frames have no return", "blackout")
    flickers = [found for pair in _pairs(seen) if (found := _flicker(*pair)) is not None]
    shares = [share for share, _ in flickers]
    if shares and float(np.median(shares)) > _FLICKER_SHARE:
        dark = float(np.median([part for _, part in flickers]))
        faults = ("dropout", "glints") if np.isnan(dark) else ("glints",) if dark > 0.5 else ("dropout",)
        text = f"{100 * np.median(shares):.0f} % of the blocks with returns have none in the next frame"
        return fail(line, text, *faults, flicker_share=float(np.median(shares)))
    share = np.median([_filled_share(kept) for kept in filled])
    text = f"{100 * share:.0f} % of pixels or rays have a return"
    if told := _empty_lines(seen):
        return note(line, f"{text}; {told}", valid_share=float(share))
    return ok(line, text, valid_share=float(share))


def _empty_lines(seen: Observations) -> str:
    """Return which rows and columns of organised scans never have a return between others that do."""
    lines = EmptyLines()
    for kept in seen.kept:
        if (grid_m := kept.frame.grid_m) is not None:
            lines.add(grid_m)
    return lines.text


def _filled_share(kept: Kept) -> float:
    depth_m = getattr(kept.frame, "depth_m", None)
    if depth_m is not None:
        return float(np.isfinite(depth_m).mean())
    return len(kept.frame.returns_m) / max(kept.raw.size // 3, 1)


def _flicker(before: Kept, after: Kept) -> tuple[float, float] | None:
    """Return the share of full blocks that are empty in the other frame, and how many of these are dark."""
    first, second = getattr(before.frame, "depth_m", None), getattr(after.frame, "depth_m", None)
    if first is not None and second is not None:
        if first.shape != second.shape:
            return None
        full = _block_share(np.isfinite(first), _IMAGE_BINS) > 0.95
        lost = full & (_block_share(np.isfinite(second), _IMAGE_BINS) < 0.05)
        amplitude = getattr(after.frame, "amplitude", None)
        dark = np.nan
        if amplitude is not None and lost.any():
            dark = float((_block_share(amplitude == 0, _IMAGE_BINS)[lost] > 0.95).mean())
        return (float(lost.sum() / full.sum()), dark) if full.sum() >= 4 else None
    if before.raw.ndim == 3 and before.raw.shape == after.raw.shape:
        masks = [np.isfinite(kept.raw[..., 0]) & kept.raw.any(axis=-1) for kept in (before, after)]
        full = _block_share(masks[0], _SCAN_BINS) > 0.8
        lost = full & (_block_share(masks[1], _SCAN_BINS) < 0.05)
        return (float(lost.sum() / full.sum()), np.nan) if full.sum() >= 4 else None
    counts = _point_blocks(before.frame.returns_m, after.frame.returns_m)
    if counts is None:
        return None
    full = counts[0] >= _LEAST_POINTS
    return (float((full & (counts[1] == 0)).sum() / full.sum()), np.nan) if full.sum() >= 4 else None


def _block_share(mask: NDArray[np.bool_], bins: int) -> NDArray[np.float64]:
    """Return the share of each of the blocks of an image in which a mask is true."""
    rows, columns = (np.arange(size) * bins // size for size in mask.shape)
    place = (rows[:, None] * bins + columns[None, :]).ravel()
    total = np.bincount(place, minlength=bins**2)
    return np.bincount(place, mask.ravel(), minlength=bins**2) / np.maximum(total, 1)


def _point_blocks(first: NDArray[Any], second: NDArray[Any]) -> NDArray[np.intp] | None:
    """Return the number of returns of two scans by blocks of direction, shape (2, blocks)."""
    if not len(first):
        return None
    angles = [np.stack(angles_of(points)[:2]) for points in (first, second)]
    low, high = angles[0].min(axis=1), angles[0].max(axis=1)
    counts = []
    for each in angles:
        place = (_SCAN_BINS * (each - low[:, None]) / np.maximum(high - low, 1e-6)[:, None]).astype(np.intp)
        inside = ((place >= 0) & (place <= _SCAN_BINS)).all(axis=0)
        place = place[:, inside].clip(0, _SCAN_BINS - 1)
        counts.append(np.bincount(place[0] * _SCAN_BINS + place[1], minlength=_SCAN_BINS**2))
    return np.array(counts)


def saturation(seen: Observations) -> CheckResult:
    """Check how many of the lit pixels are saturated."""
    line = "saturation"
    shares = []
    for kept in seen.kept:
        amplitude = getattr(kept.frame, "amplitude", None)
        if amplitude is None or not (lit := np.count_nonzero(amplitude > 0)):
            continue
        saturated = getattr(kept.frame, "saturated", None)
        shares.append(0.0 if saturated is None else np.count_nonzero(saturated) / lit)
    if not shares:
        return unchecked(line, "no amplitude came")
    share = float(np.median(shares))
    text = f"{100 * share:.1f} % of the lit pixels"
    if share > _SATURATED_SHARE:
        return fail(line, text, "saturation", saturated_share=share)
    return ok(line, text, saturated_share=share)


def exposure(seen: Observations) -> CheckResult:
    """Check whether depth and amplitude are of one exposure, where outlines move."""
    line = "exposure"
    total = summed([votes(*pair) for pair in _depth_pairs(seen)])
    if not total.suffice:
        count = total.before + total.now
        text = f"an outline has passed {count} pixels with amplitude, {LEAST_VOTES} are needed"
        return unchecked(line, f"{text}: let the target or the sensor move")
    share = total.behind_share
    text = f"{share:.0%} of the pixels that an outline has passed show the frame before"
    if total.is_behind:
        return fail(line, text, "amplitude_lags", behind_share=share)
    return ok(line, text, behind_share=share)


def _depth_pairs(seen: Observations) -> Iterator[tuple[PmdFrame, PmdFrame]]:
    """Yield successive frames of one size, the later one with an amplitude."""
    for before, after in pairwise(seen.kept):
        one, two = before.frame, after.frame
        if after.number != before.number + 1 or not (isinstance(one, PmdFrame) and isinstance(two, PmdFrame)):
            continue
        if two.amplitude is not None and one.depth_m.shape == two.depth_m.shape:
            yield one, two


def values(seen: Observations) -> CheckResult:
    """Check whether pixels without depth are NaN, and no depth is negative."""
    line = "values"
    floats = [kept.raw for kept in seen.kept if kept.encoding == "32FC1"]
    if not floats:
        return unchecked(line, "no frame with depth in 32FC1 could be read")
    zeros = float(np.median([np.mean(raw == 0.0) for raw in floats]))
    below = float(np.median([np.mean(raw < 0.0) for raw in floats]))
    if zeros or below:
        text = f"{100 * zeros:.1f} % of the pixels are 0 and {100 * below:.1f} % negative"
        return fail(line, text, "zeros_for_none", zero_share=zeros, negative_share=below)
    return ok(line, "pixels without depth are NaN")


def unit(seen: Observations, *, farthest_m: float, why: str) -> CheckResult:
    """Check whether distances can be metres: the median is at most ``farthest_m``, for the reason ``why``."""
    line = "unit"
    unit_m = seen.options.source.depth_unit_m
    middles = [middle_m(kept.raw, kept.encoding, unit_m) for kept in seen.kept] + seen.raw_middle_m
    middles = [middle for middle in middles if np.isfinite(middle)]
    if not middles:
        return unchecked(line, "no frame with a return could be read")
    middle = float(np.median(middles))
    most_m = farthest_m
    if seen.info is not None and seen.info.farthest_m < most_m:
        most_m, why = seen.info.farthest_m, "the settings in its info measure no farther"
    text = f"median distance {middle:.3g} m"
    if middle > most_m:
        return fail(line, f"{text}, more than {most_m:.3g} m: {why}", "millimetres", median_m=middle)
    if middle < _NEAR_M:
        return fail(line, f"{text}, less than {_NEAR_M:g} m", "millimetres", median_m=middle)
    return ok(line, text, median_m=middle)


def partial(seen: Observations) -> CheckResult:
    """Check whether frames or scans are cut."""
    line = "partial"
    if len(seen.kept) < 4:
        return unchecked(line, f"{len(seen.kept)} frames could be read, 4 are needed")
    if seen.kept[0].frame.images:
        cut: Sequence[float] = [_truncated_share(*pair) for pair in _pairs(seen)]
        if not cut:
            return unchecked(line, "no two successive frames could be read")
        cut_frames = sum(share > _ROWS_SHARE for share in cut)
    else:
        organised = [kept for kept in seen.kept if kept.raw.ndim == 3]
        if not organised:
            return unchecked(line, "scans have no rows and columns, and as many points as returns")
        sizes = [kept.raw.size for kept in organised]
        cut = sizes
        cut_frames = sum(size < 0.95 * max(sizes) for size in sizes)
    text = f"{cut_frames} of {len(cut)} frames are cut"
    share = cut_frames / len(cut)
    is_cut = cut_frames > 1 and share > _CUT_SHARE  # one alone may be a shadow that moves
    return fail(line, text, "partial", cut_share=share) if is_cut else ok(line, text)


def _truncated_share(before: Kept, after: Kept) -> float:
    """Return the share of a frame's live rows that are dead, to its border, in the next frame."""
    alive, then = (_live_rows(kept) for kept in (before, after))
    if alive.shape != then.shape or not then.any():
        return 0.0
    places = np.flatnonzero(then)
    first, last = int(places[0]), int(places[-1])
    beyond = np.ones(alive.shape, bool)
    beyond[first : last + 1] = False
    return float(np.count_nonzero(alive & beyond) / max(int(np.count_nonzero(alive)), 1))


def _live_rows(kept: Kept) -> NDArray[np.bool_]:
    alive = np.zeros((1, 1), bool)
    for image in kept.frame.images:
        lit = image.values > 0 if image.scale == "grey" else np.isfinite(image.values) & (image.values != 0.0)
        alive = alive | lit
    rows: NDArray[np.bool_] = alive.sum(axis=1) >= 3
    return rows
