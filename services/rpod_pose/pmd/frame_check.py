"""Whether a pose explains a PMD frame, whatever the target is made of: the pixels that contradict it.

The target is rendered at the pose and every coarse pixel is asked. A range contradicts the pose where it lies
off everything that is rendered in it and as far around it as places may be off, by more than three of its own
standard deviations, as its neighbours tell them, and what is tolerated besides. Without a range, a bright
pixel contradicts where there is no surface around it; and one as dark as the sky where there is, unless that
is seen so obliquely that foil would look as dark.

Under the right pose contradictions are rare and scattered, whatever the noise: the tails of its distribution,
mixed pixels, multiple reflections. A wrong pose, another body or a mirrored image makes them lie together
where a detail is missing or out of place. So their share is asked, and how many lie in one small patch. That
a surface is lacking is hardly ever seen under the right pose: fewer such pixels do.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from rpod_pose.pmd.rendering import Rendering, around, facing
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_check import PmdCheckConfig
from rpod_schemas.types import Float32Array

SIGMAS = 3.0
"""Standard deviations of its noise that a range may be off: one in 370 normal errors is larger."""
SKY_SPREADS = 4.5
"""Median absolute deviations of the sky, three standard ones, up to which a pixel is as dark."""
SKY_SAMPLES = 600
"""Of the pixels, those that are asked for the sky."""
BRIGHT = 0.25, 4.0
"""Times the target's median amplitude: between them a pixel without a range is bright, above it glints or is
beside a glint."""
DIM = 0.15
"""Times the same, what the sky must be darker than: from afar foil that faces elsewhere looks as dark."""
FEW = 3
"""Contrary pixels are no share: far off, or where most is lost, there are few pixels at all."""
INSIDE = 6
"""Of nine rays in and around a pixel, those that must meet surface for one to be lacking: some may miss the
facets of a thin part."""
GRAZING = 0.2
"""Cosine of incidence below which foil reflects as little as the sky."""


@dataclass(frozen=True)
class Contradictions:
    """What of a frame contradicts a pose."""

    pixels: int
    """That say something: measured, bright, or dark where surface is rendered."""
    contrary: int
    """Those of them that contradict the pose."""
    fullest: int
    """Most of those in one patch."""
    lacking: int
    """Most pixels in one patch that lack a surface: as dark as the sky where one is rendered."""

    @property
    def explained_share(self) -> float:
        """Of the pixels that say something, those that do not contradict; 0 where none does."""
        return 1.0 - self.contrary / self.pixels if self.pixels else 0.0

    @property
    def evidence(self) -> dict[str, float]:
        """The numbers by name, for a belief."""
        return {
            "inconsistent_pixel_share": self.contrary / self.pixels if self.pixels else 0.0,
            "inconsistent_pixels_in_patch": float(self.fullest),
            "missing_pixels_in_patch": float(self.lacking),
        }

    def reason(self, limits: PmdCheckConfig) -> str:
        """Return why the pose does not explain the frame; empty if it does."""
        most = limits.most_contrary_share
        if self.contrary > max(most * self.pixels, FEW):
            share = self.contrary / self.pixels
            return f"{share:.1%} of {self.pixels} pixels contradict the pose, {most:.0%} at most"
        area = limits.patch_px**2
        if self.fullest > limits.most_in_patch:
            return (
                f"a detail contradicts the pose: {self.fullest} of {area} pixels there, "
                f"{limits.most_in_patch} at most"
            )
        if self.lacking > limits.most_lacking:
            return (
                f"a detail is lacking: {self.lacking} of {area} pixels there are dark, "
                f"{limits.most_lacking} at most"
            )
        return ""


def contradictions(
    seen: tuple[FloatArray | Float32Array, ...],
    rendered: Rendering,
    limits: PmdCheckConfig,
    *,
    typical: float,
    bias_m: float = 0.0,
) -> Contradictions:
    """Return what of a frame's coarse pixels contradicts a pose.

    Args:
        seen: ranges, m, their standard deviations, m, and amplitudes, shape (rows, columns) each; what is
            not above 0, or NaN, is not known.
        rendered: the target at the pose, on the same pixels.
        limits: what is tolerated.
        typical: median amplitude of the target; 0 where none is known.
        bias_m: by which all ranges are too long.
    """
    bright, glinting = (share * typical for share in BRIGHT)
    sky = sky_amplitude(seen[0], seen[2], rendered.triangle, typical)
    shades = sky if sky < DIM * typical else 0.0, max(bright, sky), glinting
    reach_px = limits.reach_px + limits.place_m * rendered.px_per_m
    tolerated = limits.tolerance_m, bias_m, reach_px
    return Contradictions(*count_contrary(seen, rendered.arrays, shades, tolerated, limits.patch_px))


@njit(cache=True, nogil=True)
def sky_amplitude(range_m, amplitude, owner, typical):  # type: ignore[no-untyped-def]
    """Return the amplitude that the sky does not exceed, told by where nothing is measured nor rendered.

    Args:
        range_m: as for ``contradictions``.
        amplitude: as for ``contradictions``.
        owner: rendered triangles, -1 for none, same shape.
        typical: median amplitude of the target, which the sky is darker than.
    """
    rows, columns = owner.shape
    step = rows * columns // SKY_SAMPLES + 1
    dark, count = np.empty(rows * columns // step + 1), 0
    for pixel in range(0, rows * columns, step):
        i, j = pixel // columns, pixel % columns
        if owner[i, j] < 0 and not range_m[i, j] > 0.0 and 0.0 < amplitude[i, j] < typical:
            dark[count] = amplitude[i, j]
            count += 1
    if count == 0:
        return 0.0
    middle = np.median(dark[:count])
    return middle + SKY_SPREADS * np.median(np.abs(dark[:count] - middle))


@njit(cache=True, nogil=True, error_model="numpy")
def count_contrary(seen, rendered, shades, tolerated, patch):  # type: ignore[no-untyped-def]
    """Return the numbers of pixels that say something, of contrary ones, and two of the fullest patches.

    They are the most contrary pixels in one patch, and the most that lack a surface.

    Args:
        seen: as for ``contradictions``.
        rendered: ``Rendering.arrays``.
        shades: amplitude up to which a pixel is dark, and two between which it is bright.
        tolerated: error of a range besides its noise, m; bias of all ranges, m; error of a place, px.
        patch: side of a patch.
    """
    (range_m, sigma_m, amplitude), (nearest_m, owner) = seen, rendered[:2]
    dark, bright, glinting = shades
    tolerance, bias, reach = tolerated
    rows, columns = owner.shape
    full = np.zeros((2, rows + patch, columns + patch), np.int32)
    pixels, contrary = 0, 0
    for i in range(rows):
        for j in range(columns):
            shade, lacks = amplitude[i, j], False
            if range_m[i, j] > 0.0:
                measured, slack = range_m[i, j] - bias, max(tolerance, SIGMAS * sigma_m[i, j])
                pixels += 1
                if abs(measured - nearest_m[i, j]) <= slack or _is_near(
                    rendered, i, j, reach, measured, slack
                ):
                    continue
            elif bright < shade < glinting:
                pixels += 1
                if owner[i, j] >= 0 or around(rendered, i, j, reach)[2] > 0:
                    continue
            elif 0.0 < shade <= dark and owner[i, j] >= 0 and _should_show(rendered, i, j, reach):
                pixels += 1
                lacks = True
            else:
                continue
            contrary += 1
            full[0, i : i + patch, j : j + patch] += 1
            full[1, i : i + patch, j : j + patch] += lacks
    return pixels, contrary, full[0].max(), full[1].max()


@njit(cache=True, nogil=True, error_model="numpy")
def _is_near(rendered, i, j, reach, range_m, slack):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return whether a range lies on what is rendered in and around a pixel, or between."""
    low, high, _ = around(rendered, i, j, reach)
    return low - slack <= range_m <= high + slack


@njit(cache=True, nogil=True, error_model="numpy")
def _should_show(rendered, i, j, reach):  # type: ignore[no-untyped-def]
    """Return whether a pixel lies well on surface that would show whatever it is made of."""
    return facing(rendered, i, j) >= GRAZING and around(rendered, i, j, reach)[2] >= INSIDE
