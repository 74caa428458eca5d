"""Self-check of a pose in a PMD frame: the pixels that are inconsistent with it, whatever the materials.

The target is rendered at the pose, and every coarse pixel is checked. A range is compared with all rendered
ranges in and around its pixel, within the tolerated displacement. It is inconsistent with the pose if it
differs from all of them by more than the tolerance and by more than three standard deviations of its noise,
which is estimated from its neighbours. A range may be longer if the target reflects light onto itself
(``reflections``). A pixel without a range is inconsistent in two cases: it is bright and no surface is
rendered around it, or it is as dark as the sky and a surface is rendered. In the second case the surface must
not be seen so obliquely that foil would be as dark.

At the right pose such pixels are rare and scattered, whatever the noise: they come from the tails of its
distribution, from mixed pixels and from multiple reflections. With a wrong pose, another body or a mirrored
image they form groups where a detail is missing or misplaced. Therefore their share is limited, and also
their number in one small patch. Missing surface is very rare at the right pose, so fewer such pixels are
allowed.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_pose.pmd.rendering import (
    COARSE_ONLY,
    Around,
    FineRanges,
    Rendering,
    RenderingArrays,
    around,
    around_finely,
    facing,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.check import PmdCheckConfig
from rpod_schemas.types import Float32Array

SIGMAS = 3.0
"""Largest consistent error of a range, in standard deviations. Physics: one in 370 normal errors is
larger."""
DARK_SPREADS, LIT_SPREADS = 4.5, 9.0
"""Limits of amplitude above the sky's median, in median absolute deviations: below the first a pixel is as
dark as the sky, above the second it shows a surface. Physics: three and six standard deviations of normal
noise; in an image, dozens of pixels of the sky are above three."""
SKY_SAMPLES = 600
"""Number of pixels from which the sky's amplitude is estimated. Numerics: their median is known to a
twentieth of a standard deviation."""
BRIGHT = 0.25, 4.0
"""Limits over the target's median amplitude: between them a pixel without a range is bright; above them it
glints or is beside a glint. Hand: a narrower interval finds fewer contradictions, a wider one takes shaded
faces for bright."""
DIM = 0.15
"""Largest amplitude of the sky, over the target's median, at which dark pixels are checked. Hand: from far
away, foil at an angle is as dark as the sky."""
NEGLIGIBLE = 3
"""Number of inconsistent pixels that is always tolerated. Hand: a distant target has only few pixels."""
LEAST_HITS = 6
"""Least number of the nine rays in and around a pixel that meet the target if a missing surface counts. Hand:
some may miss the facets of a thin part; beside the edge of a face six meet it."""
NOT_REFLECTED = np.empty(0)
"""Table of second reflections that are unknown."""
GRAZING = 0.2
"""Cosine of incidence below which foil is as dark as the sky. Hand: 78 deg; a surface counts as missing only
if it faces the camera more."""


@dataclass(frozen=True)
class Contradictions:
    """Numbers of pixels that are inconsistent with a pose."""

    pixels: int
    """Number of checked pixels: measured, bright, or dark where a surface is rendered."""
    inconsistent: int
    """Number of checked pixels that are inconsistent with the pose."""
    most_in_patch: int
    """Largest number of inconsistent pixels in one patch."""
    most_missing: int
    """Largest number of pixels in one patch that are as dark as the sky where a surface is rendered."""
    marked: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), np.bool_), compare=False)
    """Which coarse pixels are inconsistent with the pose, shape (rows, columns)."""

    @property
    def explained_share(self) -> float:
        """Share of the checked pixels that are consistent with the pose; 0 if no pixel is checked."""
        return 1.0 - self.inconsistent / self.pixels if self.pixels else 0.0

    @property
    def evidence(self) -> dict[str, float]:
        """The numbers by name, for the evidence of a belief; the share is 0 if the pixels are negligible."""
        counted = self.inconsistent if self.inconsistent > NEGLIGIBLE else 0
        return {
            "inconsistent_pixel_share": counted / self.pixels if self.pixels else 0.0,
            "inconsistent_pixels_in_patch": float(self.most_in_patch),
            "missing_pixels_in_patch": float(self.most_missing),
        }

    def reason(self, limits: PmdCheckConfig) -> str:
        """Return why the pose does not explain the frame; empty if it does."""
        share, most = self.evidence["inconsistent_pixel_share"], limits.most_inconsistent_share
        if share > most:
            return f"{share:.1%} of {self.pixels} pixels are inconsistent with the pose, limit {most:.1%}"
        area = limits.patch_px**2
        if self.most_in_patch > limits.most_in_patch:
            return (
                f"a detail is inconsistent with the pose: {self.most_in_patch} of {area} pixels of a patch, "
                f"limit {limits.most_in_patch}"
            )
        if self.most_missing > limits.most_missing:
            return (
                f"a detail is missing: {self.most_missing} of {area} pixels of a patch are dark, "
                f"limit {limits.most_missing}"
            )
        return ""


class SeenPixels(NamedTuple):
    """A frame's coarse pixels, shape (rows, columns) each; values that are not above 0 are unknown."""

    range_m: FloatArray
    """Ranges along the rays."""
    sigma_m: FloatArray
    """Standard deviations of the ranges' noise."""
    amplitude: FloatArray
    """Amplitudes, counts."""


class Shades(NamedTuple):
    """Limits of amplitude between dark and bright pixels."""

    dark: float
    """Largest amplitude of a pixel as dark as the sky; 0 if dark pixels are not checked."""
    bright: float
    """Amplitude above which a pixel shows a surface."""
    glinting: float
    """Least amplitude of a pixel that glints or is beside a glint."""


class Tolerated(NamedTuple):
    """Errors that the check tolerates."""

    range_m: float
    """Tolerated error of a range in addition to its noise."""
    bias_m: float
    """Length by which all ranges are too long."""
    place_px: float
    """Tolerated displacement in the image."""
    reflected_m: FloatArray
    """Length by which a second reflection may lengthen a range on each triangle at normal incidence, shape
    (T,); shape (0,) if it is unknown."""


class Shown(NamedTuple):
    """The target rendered at a pose."""

    coarse: RenderingArrays
    """Rendering on the coarse pixels."""
    fine: FineRanges
    """Ranges of a rendering with more rays; ``COARSE_ONLY`` without such a rendering."""


class PixelCounts(NamedTuple):
    """Pixels that are inconsistent with a pose: the fields of ``Contradictions``."""

    pixels: int
    inconsistent: int
    most_in_patch: int
    most_missing: int
    marked: NDArray[np.bool_]


def contradictions(
    seen: SeenPixels,
    rendered: Rendering,
    limits: PmdCheckConfig,
    *,
    radius_m: float,
    typical: float,
    uneven_m: float = 0.0,
    bias_m: float = 0.0,
    reflected_m: FloatArray = NOT_REFLECTED,
    fine: FineRanges = COARSE_ONLY,
) -> Contradictions:
    """Return which of a frame's coarse pixels are inconsistent with a pose, and their numbers.

    Args:
        seen: the frame's coarse pixels.
        rendered: the target at the pose, on the same pixels.
        limits: tolerances of the check.
        radius_m: radius of the target.
        typical: median amplitude of the target; 0 if it is unknown.
        uneven_m: standard deviation of range errors that differ across the target.
        bias_m: length by which all ranges are too long.
        reflected_m: length by which light that is reflected twice may lengthen a range at normal incidence,
            for each triangle, shape (T,); shape (0,) if it is unknown.
        fine: a rendering at the same pose with more rays, which shows thin parts.
    """
    bright, glinting = (share * typical for share in BRIGHT)
    sky, spread = sky_amplitude(seen.range_m, seen.amplitude, rendered.triangle, typical)
    dark = sky + DARK_SPREADS * spread
    shades = Shades(dark if dark < DIM * typical else 0.0, max(bright, sky + LIT_SPREADS * spread), glinting)
    reach_px = limits.reach_px + limits.place_share * radius_m * rendered.px_per_m
    tolerance_m = max(limits.tolerance_share * radius_m, SIGMAS * uneven_m)
    tolerated = Tolerated(tolerance_m, bias_m, reach_px, reflected_m)
    shown = Shown(rendered.arrays, fine)
    return Contradictions(*count_inconsistent(seen, shown, shades, tolerated, limits.patch_px))


@kernel
def sky_amplitude(
    range_m: FloatArray | Float32Array,
    amplitude: FloatArray | Float32Array,
    owner: NDArray[np.int32],
    typical: float,
) -> tuple[float, float]:
    """Return the median amplitude of the sky and its median absolute deviation; zeros if they are unknown.

    They are taken from pixels without a measured range and without a rendered surface.

    Args:
        range_m: as for ``contradictions``.
        amplitude: as for ``contradictions``.
        owner: rendered triangles, -1 for none, same shape.
        typical: median amplitude of the target; brighter pixels do not show the sky.
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
        return 0.0, 0.0
    middle = np.median(dark[:count])
    return float(middle), float(np.median(np.abs(dark[:count] - middle)))


@kernel
def count_inconsistent(
    seen: SeenPixels, shown: Shown, shades: Shades, tolerated: Tolerated, patch: int
) -> PixelCounts:
    """Return the inconsistent pixels and the numbers of pixels: the fields of ``Contradictions``.

    Args:
        seen: the frame's coarse pixels.
        shown: the target at the pose, on the same pixels and with more rays.
        shades: limits of amplitude between dark and bright.
        tolerated: tolerated errors.
        patch: side of a patch, px, at least 1.
    """
    range_m, sigma_m, amplitude = seen
    nearest_m, owner = shown.coarse.range_m, shown.coarse.triangle
    dark, bright, glinting = shades
    reach = tolerated.place_px
    rows, columns = owner.shape
    full = np.zeros((2, rows + patch, columns + patch), np.int32)
    marked = np.zeros((rows, columns), np.bool_)
    pixels, inconsistent = 0, 0
    for i in range(rows):
        for j in range(columns):
            shade, is_missing = amplitude[i, j], False
            if range_m[i, j] > 0.0:
                measured = range_m[i, j] - tolerated.bias_m
                slack = max(tolerated.range_m, SIGMAS * sigma_m[i, j])
                pixels += 1
                if abs(measured - nearest_m[i, j]) <= slack:
                    continue
                longer = slack + longer_m(shown.coarse, i, j, tolerated.reflected_m)
                low, high, _ = _around(shown, i, j, reach)
                if low - slack <= measured <= high + longer:
                    continue
            elif bright < shade < glinting:
                pixels += 1
                if owner[i, j] >= 0 or _around(shown, i, j, reach).hits > 0:
                    continue
            elif 0.0 < shade <= dark and owner[i, j] >= 0 and _should_show(shown, i, j, reach):
                pixels += 1
                is_missing = True
            else:
                continue
            inconsistent += 1
            marked[i, j] = True
            full[0, i : i + patch, j : j + patch] += 1
            full[1, i : i + patch, j : j + patch] += is_missing
    return PixelCounts(pixels, inconsistent, full[0].max(), full[1].max(), marked)


@kernel
def longer_m(rendered: RenderingArrays, i: int, j: int, reflected_m: FloatArray) -> float:
    """Return the length by which light that is reflected twice may lengthen a coarse pixel's range, m.

    Args:
        rendered: the target at the pose.
        i: row of the coarse pixel.
        j: column of the coarse pixel.
        reflected_m: for each triangle, as for ``contradictions``, m, shape (triangles,).
    """
    triangle = rendered.triangle[i, j]
    if triangle < 0 or triangle >= reflected_m.size:
        return 0.0
    return float(reflected_m[triangle] / max(facing(rendered, i, j), GRAZING))


@inner_kernel
def _should_show(shown: Shown, i: int, j: int, reach: float) -> bool:
    """Return whether a pixel lies in a surface that is brighter than the sky, whatever its material."""
    return facing(shown.coarse, i, j) >= GRAZING and _around(shown, i, j, reach).hits >= LEAST_HITS


@inner_kernel
def _around(shown: Shown, i: int, j: int, reach: float) -> Around:
    """Return the ranges in and around a coarse pixel, from the fine rays if there are any."""
    if shown.fine.range_m.size:
        return around_finely(shown.fine, shown.coarse.stride, i, j, reach)
    return around(shown.coarse, i, j, reach)
