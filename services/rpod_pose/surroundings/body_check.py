"""Check whether sensors see a known body at the place that its pose states.

If the encoders, the calibration or the file of a body are wrong, good pixels are removed, and the pixels of
the body stay. A ray that should meet the body ends on it, in front of it (something hides the body there),
beyond it, or has no range. If most of the rays that nothing hides end elsewhere, the same shape is searched
nearby. Its surface must be found at one offset, and must end where the body ends, so that a wall behind the
body is not taken for it. A dark body gives no ranges at all. In this case the body is not seen and not
checked.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_pose.surroundings.separation import RangeImage, Spans
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

LEAST_RAYS = 20
"""Least number of rays that should meet a body, and that nothing hides, for a check. Hand: fewer rays give a
share with an error of a tenth or more."""
LEAST_SHARE = 0.5
"""Least share of these rays that must end on the body. Hand: the others may be dark, or too oblique for a
range."""
MOST_BEYOND = 0.1
"""Largest share of a body's rays with a range that end beyond it. Hand: none does within its tolerance."""
FARTHEST_STEPS = 8
"""Largest offset at which the shape is searched, in tolerances, along each direction. Numerics: a budget; the
time grows with its square."""
FOUND_SHARE, ENDS_SHARE = 0.6, 0.4
"""Least share of the shape that must be found at an offset, and least difference to the share of agreeing
rays around it. Hand: the share is above chance, and smaller around the shape, so that a wall is not taken for
it."""
THICK = 0.1
"""Least share of a thick body's rays that are farther than its tolerance from its outline. Hand: with fewer
the body counts as thin."""
STEEPEST = 0.2
"""Least cosine of incidence by which a distance along a ray is converted to one from the surface. Hand: 78
deg; at larger angles such a distance is mostly noise."""
LEAST_SEEN = 0.75
"""Least share of the shape that must be in the image at an offset. Hand: a quarter may be outside it."""
BETTER_SHARE = 0.2
"""Least excess of the share of the shape that is found at an offset over that at its announced place. Hand: a
smaller value reports bodies that are in their place."""
NEAREST_FIRST = 0.03
"""Share that is subtracted for each tolerance of offset. Hand: along a long limb many offsets fit equally."""
MOST_INSIDE, MOST_AROUND = 300, 150
"""Largest numbers of rays on the shape and around it that are compared at each offset. Numerics: budgets; a
share is then known to 3 and 4 %."""
FRAMES = 3
"""Number of checked frames in a row after which a body's state changes. Hand: one frame may be disturbed."""


class BodyState(StrEnum):
    """State of a body in one frame."""

    IN_PLACE = "in_place"
    """It is seen at the place that its pose states."""
    ELSEWHERE = "elsewhere"
    """Rays pass through its announced place, or its shape is found at another one."""
    UNSEEN = "unseen"
    """Most of its rays have no range: it is dark, or it is not there."""
    HIDDEN = "hidden"
    """Too few rays should meet it, or other things hide it: it is not checked."""


class Place(NamedTuple):
    """A body rendered in a frame at its pose, with its tolerance."""

    rendered_m: Float32Array
    """Range of its surface, shape (rows, columns), infinite on rays that do not meet it."""
    nearest_m: Float32Array
    """Least range of its surface within its tolerance, same shape."""
    farthest_m: Float32Array
    """Largest range of its surface within its tolerance, same shape; the tolerance on rays far from it."""
    cosine: FloatArray
    """Cosine of incidence of the rays that meet it, same shape."""
    tolerance_m: float
    reach: Spans
    """Numbers of rays that its tolerance spans."""

    def agreeing(self, measured_m: Float32Array) -> NDArray[np.bool_]:
        """Return the rays whose measured ranges, 0 without one, are those of the body, shape (rows, columns).

        Ranges are compared by the distance from the surface, not by that along the ray. A body that is
        thinner than its tolerance may lie completely beside its rays.
        """
        met, measured = np.isfinite(self.rendered_m), measured_m > 0.0
        if np.count_nonzero(cv2.erode(met.view(np.uint8), self.reach.around)) < THICK * np.count_nonzero(met):
            return measured & (measured_m >= self.nearest_m) & (measured_m <= self.farthest_m)
        away_m = np.abs(measured_m - np.where(met, self.rendered_m, 0.0)) * np.maximum(self.cosine, STEEPEST)
        agrees: NDArray[np.bool_] = measured & met & (away_m <= self.tolerance_m)
        return agrees


@dataclass(frozen=True, eq=False)
class Sighting:
    """Evidence of one frame for one body and its pose."""

    body: str
    state: BodyState
    tolerance_m: float
    rays: int = 0
    """Number of rays that should meet the body and that nothing hides."""
    in_place: int = 0
    """Number of these rays that end on the body."""
    beyond: int = 0
    """Number of these rays that end beyond the body."""
    offset_m: FloatArray | None = None
    """Offset at which the shape is found, sensor axes, shape (3,); None if it is not."""

    @property
    def missing(self) -> int:
        """Number of the rays without a range."""
        return self.rays - self.in_place - self.beyond


def sighting(body: str, image: RangeImage, place: Place) -> Sighting:
    """Return the evidence of a frame for a body."""
    met, measured_m = np.isfinite(place.rendered_m), image.range_m
    measured = measured_m > 0.0
    near = cv2.dilate(place.agreeing(measured_m).view(np.uint8), place.reach.around).view(np.bool_)
    in_place = int(np.count_nonzero(met & near))
    beyond = int(np.count_nonzero(met & ~near & measured & (measured_m > place.farthest_m)))
    missing = int(np.count_nonzero(met & ~near & ~measured))
    every, rays = int(np.count_nonzero(met)), in_place + beyond + missing
    passed = beyond > MOST_BEYOND * (in_place + beyond)
    if every < LEAST_RAYS:
        return Sighting(body, BodyState.HIDDEN, place.tolerance_m, rays, in_place, beyond)
    if in_place >= LEAST_SHARE * every and not passed:
        return Sighting(body, BodyState.IN_PLACE, place.tolerance_m, rays, in_place, beyond)
    offset_m = _offset(image, place, met, in_place / every)
    if offset_m is not None:
        state = BodyState.ELSEWHERE
    elif rays < LEAST_RAYS:
        state = BodyState.HIDDEN
    elif passed:
        state = BodyState.ELSEWHERE
    else:
        state = BodyState.IN_PLACE if in_place >= LEAST_SHARE * rays else BodyState.UNSEEN
    return Sighting(body, state, place.tolerance_m, rays, in_place, beyond, offset_m)


class _Rays(NamedTuple):
    """Some rays of an image, with the range of the body's surface on each."""

    row: NDArray[np.intp]
    """Row of each ray in the image, shape (N,)."""
    column: NDArray[np.intp]
    """Column of each ray in the image, shape (N,)."""
    rendered_m: Float32Array
    """Range of the body's surface on each ray, shape (N,)."""

    def shifted(
        self, image_m: Float32Array, shifts: NDArray[np.intp]
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return measured ranges minus those of the shifted surface, and which rays are in the image.

        Args:
            image_m: measured ranges, 0 without one.
            shifts: rows and columns of each shift, shape (S, 2).

        Returns:
            Differences, m, NaN without a range; and which of the rays are in the image; each of shape (S, N).
        """
        row, column = (place + shifts[:, k : k + 1] for k, place in enumerate((self.row, self.column)))
        inside = (row >= 0) & (row < image_m.shape[0]) & (column >= 0) & (column < image_m.shape[1])
        measured_m = np.where(inside, image_m[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0)
        return np.where(measured_m > 0.0, measured_m - self.rendered_m, np.nan), inside


def _subsampled(rays: NDArray[np.bool_], rendered_m: Float32Array, most: int) -> _Rays:
    """Return at most about ``most`` of some rays, evenly distributed."""
    row, column = np.nonzero(rays)
    every = max(1, row.size // most)
    row, column = row[::every], column[::every]
    return _Rays(row, column, rendered_m[row, column])


def _offset(
    image: RangeImage, place: Place, met: NDArray[np.bool_], in_place_share: float
) -> FloatArray | None:
    """Return the offset of the body's shape in the sensor's axes, shape (3,), m; None if it is not found."""
    inside = _subsampled(met, place.rendered_m, MOST_INSIDE)
    ring_m = place.farthest_m - np.float32(place.tolerance_m)
    around = _subsampled(_beside(met, place.reach), ring_m, MOST_AROUND)
    steps = np.arange(-FARTHEST_STEPS, FARTHEST_STEPS + 1)
    in_tolerances = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    shifts = in_tolerances * np.array(place.reach)
    off_m, seen = inside.shifted(image.range_m, shifts)
    along_m = _medians(off_m, seen)
    near = np.abs(along_m) <= FARTHEST_STEPS * place.tolerance_m
    share = _agreeing(off_m, along_m, seen, place.tolerance_m) * near
    beside_m, beside = around.shifted(image.range_m, shifts)
    goes_on = _agreeing(beside_m, along_m, beside, place.tolerance_m)
    score = share - goes_on - NEAREST_FIRST * np.hypot(*in_tolerances.T)
    score[(share < FOUND_SHARE) | (share - goes_on < ENDS_SHARE)] = -np.inf
    best = int(np.argmax(score))
    if score[best] == -np.inf or share[best] < in_place_share + BETTER_SHARE:
        return None
    found = seen[best]
    row, column, rendered_m = inside.row[found], inside.column[found], inside.rendered_m[found]
    directions: FloatArray = image.grid.directions
    down, right = shifts[best]
    before_m = rendered_m[:, None] * directions[row, column]
    after_m = (rendered_m + along_m[best])[:, None] * directions[row + down, column + right]
    offset_m: FloatArray = (after_m - before_m).mean(axis=0).astype(np.float64)
    return offset_m


def _medians(off_m: FloatArray, seen: NDArray[np.bool_]) -> FloatArray:
    """Return the median of each row; infinite if too few rays are in the image, or have a range."""
    returned = np.isfinite(off_m).sum(axis=1)
    ordered = np.sort(off_m, axis=1)  # NaN comes last
    medians_m: FloatArray = ordered[np.arange(len(ordered)), returned // 2]
    usable = (
        (2 * returned > seen.sum(axis=1)) & (seen.sum(axis=1) >= LEAST_SEEN * seen.shape[1]) & (returned > 0)
    )
    return np.where(usable, medians_m, np.inf)


def _agreeing(
    off_m: FloatArray, along_m: FloatArray, seen: NDArray[np.bool_], tolerance_m: float
) -> FloatArray:
    """Return the share of the rays in the image at which the surface is found at an offset, shape (S,)."""
    with np.errstate(invalid="ignore"):
        agrees = np.abs(off_m - along_m[:, None]) <= tolerance_m
    share: FloatArray = (agrees & seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return share


def _beside(met: NDArray[np.bool_], reach: Spans) -> NDArray[np.bool_]:
    """Return the rays a tolerance beside those that meet a body."""
    shapes = (reach.longer(-1).around, reach.around)
    inner, outer = (cv2.dilate(met.view(np.uint8), shape).view(np.bool_) for shape in shapes)
    ring: NDArray[np.bool_] = outer & ~inner
    return ring


@dataclass
class _Record:
    state: BodyState = BodyState.IN_PLACE
    newest: BodyState = BodyState.HIDDEN
    in_a_row: int = 0
    text: str = ""


@dataclass
class BodyBook:
    """States of the bodies in the frames of each sensor, with the texts for an operator."""

    counts: Counter[tuple[str, str, BodyState]] = field(default_factory=Counter)
    """Number of frames by body, sensor and state."""
    _records: dict[tuple[str, str], _Record] = field(default_factory=dict)

    def take(self, sensor: str, seen: Sighting, R_chaser_sensor: FloatArray) -> bool:
        """Add the evidence of a frame; return whether the body's pose is believed for this frame.

        The pose is not believed if the sensor has seen the body elsewhere in ``FRAMES`` frames in a row,
        unless this frame shows the body in its place.

        Args:
            sensor: name of the sensor.
            seen: what the frame shows.
            R_chaser_sensor: rotation matrix from sensor axes to chaser axes, shape (3, 3).
        """
        self.counts[seen.body, sensor, seen.state] += 1
        record = self._records.setdefault((seen.body, sensor), _Record())
        if seen.state is not BodyState.HIDDEN:
            record.in_a_row = record.in_a_row + 1 if seen.state is record.newest else 1
            record.newest = seen.state
            if record.in_a_row >= FRAMES:
                record.state = seen.state
            if record.state is seen.state:
                record.text = warning_of(sensor, seen, R_chaser_sensor)
        return record.state is not BodyState.ELSEWHERE or seen.state is BodyState.IN_PLACE

    @property
    def states(self) -> Iterator[tuple[str, str, BodyState, str]]:
        """Yield body, sensor, state and its text, which is empty for a body that is seen in its place."""
        for (body, sensor), record in self._records.items():
            yield body, sensor, record.state, record.text


def warning_of(sensor: str, seen: Sighting, R_chaser_sensor: FloatArray) -> str:
    """Return the warning about a body, with figures and remedy; empty if it is in its place."""
    if seen.state in (BodyState.IN_PLACE, BodyState.HIDDEN):
        return ""
    if seen.state is BodyState.UNSEEN:
        return (
            f"{sensor} does not see the known body {seen.body}: {seen.missing} of {seen.rays} rays on it "
            "have no range, so that its pose is not checked: it is too dark, or not there; compare it with "
            "the sensor's picture"
        )
    remedy = (
        "it is not taken out of the frames, and may be taken for the target: check the encoders and "
        f"the base of its robot, its pose in the file of surroundings and the mount of {sensor}, or raise "
        f"its tolerance_m ({seen.tolerance_m:g})"
    )
    if seen.offset_m is None:
        return (
            f"{sensor} does not see the known body {seen.body} where its pose says: of {seen.rays} rays that "
            f"should meet it {seen.beyond} end beyond it and {seen.missing} nowhere; {remedy}"
        )
    x, y, z = R_chaser_sensor @ seen.offset_m
    return (
        f"{sensor} sees the known body {seen.body} {np.linalg.norm(seen.offset_m):.2f} m away from its pose, "
        f"by about x {x:+.2f}, y {y:+.2f}, z {z:+.2f} m in the chaser's axes; {remedy}"
    )
