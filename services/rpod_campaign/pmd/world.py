"""Differences between the imaged world and the estimator's model of it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rpod_campaign.engine.trial.targets import cached_target
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import PmdFrame
from rpod_target import Target
from rpod_target.mesh.topology import unit_normals

_PATCHES = 12
"""Number of patches along each side of the image: depth is lost in areas, not in single pixels."""
_GLINT_PX = (6, 30)
"""Least and greatest radius of a glint, px."""
_MOST_GLINTS = 400


@dataclass(frozen=True)
class World:
    """Differences between world and model; the default has none."""

    cad_error_m: float = 0.0
    """Standard deviation of the parts' places and of their sizes along each axis, m."""
    coat: str | None = None
    """Material that covers everything; None for the target file's own."""
    scale: float = 1.0
    """Size of the target over that of its model."""
    depth_lost_share: float = 0.0
    """Share of the image without depth, in patches; the amplitude is kept."""
    glint_share: float = 0.0
    """Share of the target's pixels whose depth and amplitude glints remove."""


NOMINAL = World()


def built(target: Target, world: World, generator: Generator) -> Target:
    """Return the target as built, which differs from its model.

    The first part defines the target's axes, so that only its size differs, not its place.
    """
    if world.coat is not None:
        target = _coated(target, world.coat)
    if world.scale != 1.0:
        target = replace(target, triangles_m=world.scale * target.triangles_m)
    if not world.cad_error_m:
        return target
    triangles_m = target.triangles_m.copy()
    for part in range(len(target.parts)):
        mine = target.triangle_part == part
        shift_m, growth_m = world.cad_error_m * generator.standard_normal((2, 3))
        triangles_m[mine] = _misbuilt(triangles_m[mine], shift_m * (part > 0), growth_m)
    return replace(target, triangles_m=triangles_m, normals=unit_normals(triangles_m))


def _misbuilt(triangles_m: FloatArray, shift_m: FloatArray, growth_m: FloatArray) -> FloatArray:
    """Return a part displaced, and larger along each axis about the centre of its bounding box."""
    low, high = triangles_m.min(axis=(0, 1)), triangles_m.max(axis=(0, 1))
    centre, size = (low + high) / 2.0, high - low
    grown: FloatArray = centre + shift_m + (triangles_m - centre) * (1.0 + growth_m / size)
    return grown


def has_material(target: str, material: str) -> bool:
    """Return whether the target of a name has a material. Only with such a material can it be covered."""
    return any(known.name == material for known in cached_target(target).materials)


def _coated(target: Target, material: str) -> Target:
    index = [known.name for known in target.materials].index(material)
    return replace(target, triangle_material=np.full_like(target.triangle_material, index))


def disturbed(frame: PmdFrame, world: World, generator: Generator, *, seen: NDArray[np.bool_]) -> PmdFrame:
    """Return a frame with the world's disturbances; in a glint both taps are full and their difference is 0.

    Args:
        frame: frame of the camera.
        world: disturbances.
        generator: random numbers of this frame.
        seen: pixels that see the target, shape (H, W).
    """
    depth_m, amplitude = frame.depth_m, frame.amplitude
    if world.depth_lost_share:
        lost = _patches(depth_m.shape, world.depth_lost_share, generator)
        depth_m = np.where(lost, np.float32(np.nan), depth_m)
    if world.glint_share:
        wiped = glints(seen, world.glint_share, generator)
        depth_m = np.where(wiped, np.float32(np.nan), depth_m)
        if amplitude is not None:
            amplitude = np.where(wiped, amplitude.dtype.type(0), amplitude)
    return frame.model_copy(update={"depth_m": depth_m, "amplitude": amplitude})


def glints(seen: NDArray[np.bool_], share: float, generator: Generator) -> NDArray[np.bool_]:
    """Return random discs on the target, as many as cover a share of it; shape (H, W)."""
    rows, columns = np.nonzero(seen)
    wiped = np.zeros_like(seen)
    row, column = np.ogrid[: seen.shape[0], : seen.shape[1]]
    for _ in range(_MOST_GLINTS):
        if not rows.size or wiped[rows, columns].mean() >= share:
            break
        centre, radius_px = generator.integers(rows.size), generator.uniform(*_GLINT_PX)
        wiped |= (row - rows[centre]) ** 2 + (column - columns[centre]) ** 2 < radius_px**2
    return wiped


def _patches(shape: tuple[int, ...], share: float, generator: Generator) -> NDArray[np.bool_]:
    lost = generator.random((_PATCHES, _PATCHES)) < share
    rows, columns = (np.arange(size) * _PATCHES // size for size in shape[:2])
    return lost[np.ix_(rows, columns)]
