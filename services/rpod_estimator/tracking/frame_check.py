"""Whether a pose explains a PMD frame, whatever the target is made of: the pixels that contradict it.

The target is rendered at the pose and every coarse pixel is asked. A range contradicts the pose where it lies
off everything that is rendered within a pixel around it by more than three of its own standard deviations,
as its neighbours tell them, and what is tolerated besides. Without a range, a pixel as dark as the sky does
where surface is rendered all around it, and a bright one where there is none.

Under the right pose contradictions are rare and scattered, whatever the noise: the tails of its distribution,
mixed pixels, multiple reflections. A wrong pose, another body or a mirrored image makes them lie together
where a detail is missing or out of place. So their share is asked, and how many lie in one small patch.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_check import PmdCheckConfig
from rpod_schemas.types import Float32Array

SIGMAS = 3.0
"""Standard deviations of its noise that a range may be off: one in 370 normal errors is larger."""
SKY_SPREADS = 9.0
"""Median absolute deviations of the sky, six standard ones, up to which a pixel is as dark."""
SKY_SAMPLES = 600
"""Of the pixels, those that are asked for the sky."""
BRIGHT = 0.25, 4.0
"""Times the target's median amplitude: between them a pixel without a range is bright, above it glints or is
beside a glint."""
NINE = 9
"""A pixel and its neighbours."""


@dataclass(frozen=True)
class Contradictions:
    """What of a frame contradicts a pose."""

    pixels: int
    """That say something: measured, bright, or dark where surface is rendered."""
    contrary: int
    """Those of them that contradict the pose."""
    fullest: int
    """Most of those in one patch."""

    @property
    def explained_share(self) -> float:
        """Of the pixels that say something, those that do not contradict; 0 where none does."""
        return 1.0 - self.contrary / self.pixels if self.pixels else 0.0

    def doubt(self, limits: PmdCheckConfig) -> str:
        """Return why the pose does not explain the frame; empty if it does."""
        most = limits.most_contrary_share
        if self.contrary > most * self.pixels:
            share = self.contrary / self.pixels
            return f"{share:.1%} of {self.pixels} pixels contradict the pose, {most:.0%} at most"
        if self.fullest > limits.most_in_patch:
            area = limits.patch_px**2
            return (
                f"a detail contradicts the pose: {self.fullest} of {area} pixels there, "
                f"{limits.most_in_patch} at most"
            )
        return ""


def contradictions(
    seen: tuple[FloatArray | Float32Array, ...],
    rendered: tuple[NDArray[np.float32], NDArray[np.int32]],
    limits: PmdCheckConfig,
    *,
    typical: float,
    bias_m: float = 0.0,
) -> Contradictions:
    """Return what of a frame's coarse pixels contradicts a pose.

    Args:
        seen: ranges, m, their standard deviations, m, and amplitudes, shape (rows, columns) each; what is
            not above 0, or NaN, is not known.
        rendered: ranges, m, inf where there is none, and triangles, -1 there, at the pose; same shape.
        limits: what is tolerated.
        typical: median amplitude of the target; 0 where none is known.
        bias_m: by which all ranges are too long.
    """
    bright, glinting = (share * typical for share in BRIGHT)
    sky = sky_amplitude(seen[0], seen[2], rendered[1], typical)
    shades = sky if sky < bright else 0.0, max(bright, sky), glinting
    return Contradictions(
        *count_contrary(seen, rendered, shades, (limits.tolerance_m, bias_m), limits.patch_px)
    )


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
    """Return the numbers of pixels that say something, of contrary ones, and of the latter in one patch.

    Args:
        seen: as for ``contradictions``.
        rendered: as for ``contradictions``.
        shades: amplitude up to which a pixel is dark, and two between which it is bright.
        tolerated: error of a range besides its noise, m; bias of all ranges, m.
        patch: side of a patch.
    """
    amplitude, owner = seen[2], rendered[1]
    dark, bright, glinting = shades
    rows, columns = owner.shape
    full = np.zeros((rows + patch, columns + patch), np.int32)
    pixels, contrary, fullest = 0, 0, 0
    for i in range(rows):
        for j in range(columns):
            shade = amplitude[i, j]
            if seen[0][i, j] > 0.0:
                contradicts = _is_off(seen, rendered, tolerated, i, j)
            elif bright < shade < glinting:
                contradicts = _rendered_around(owner, i, j) == 0
            elif 0.0 < shade <= dark and _rendered_around(owner, i, j) == NINE:
                contradicts = True
            else:
                continue
            pixels += 1
            contrary += contradicts
            for v in range(i, i + patch if contradicts else i):
                for u in range(j, j + patch):
                    full[v, u] += 1
                    fullest = max(fullest, full[v, u])
    return pixels, contrary, fullest


@njit(cache=True, nogil=True, error_model="numpy")
def _is_off(seen, rendered, tolerated, i, j):  # type: ignore[no-untyped-def]
    """Return whether a pixel's range lies off all that is rendered within a pixel around it."""
    range_m, sigma, _ = seen
    nearest, owner = rendered
    tolerance, bias = tolerated
    low, high = np.inf, 0.0
    for v in range(max(i - 1, 0), min(i + 2, owner.shape[0])):
        for u in range(max(j - 1, 0), min(j + 2, owner.shape[1])):
            if owner[v, u] >= 0:
                low, high = min(low, nearest[v, u]), max(high, nearest[v, u])
    slack = max(tolerance, SIGMAS * sigma[i, j])
    return not low - slack <= range_m[i, j] - bias <= high + slack


@njit(cache=True, nogil=True, error_model="numpy")
def _rendered_around(owner, i, j):  # type: ignore[no-untyped-def]
    """Return on how many of a pixel and its neighbours there is surface."""
    count = 0
    for v in range(max(i - 1, 0), min(i + 2, owner.shape[0])):
        for u in range(max(j - 1, 0), min(j + 2, owner.shape[1])):
            count += owner[v, u] >= 0
    return count
