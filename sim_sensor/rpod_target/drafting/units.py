"""Unit of a CAD file's lengths: stated by the user or by the format, never guessed."""

from pathlib import Path
from typing import Protocol

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target.errors import TargetError
from rpod_target.mesh.files import METRIC, STEP, MeshFile
from rpod_target.mesh.topology import areas_m2
from rpod_target.mesh.unusable import NO_AREA
from rpod_target.parameters import LARGEST_M, SMALLEST_M, usual_size

_LEFT_OVER, _FAR = 2.5e-3, 2.0
"""Share of the area beyond each side of the box that holds most of a mesh, and ratio of the longest sides
above which the rest is told. Hand."""
_COARSE = 1e-3
"""Share of the longest side above which steps of the coordinates are told: the bound of a simplification."""
METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048, "km": 1e3}
"""Metres in the units that a drawing may have."""


class StatedSize(Protocol):
    """What a user says of the size of a CAD file."""

    @property
    def units(self) -> str | None:
        """Unit of the file's coordinates, one of ``METRES``."""

    @property
    def longest_side_m(self) -> float | None:
        """Length of the longest side of the bounding box; it takes precedence over a unit."""

    @property
    def confirmed_size(self) -> bool:
        """Whether a size below 0.05 m or above 500 m is meant."""


def metres_per_unit(cad: Path, mesh: MeshFile, options: StatedSize, told: list[str]) -> float:
    """Return metres per unit of a CAD file; say in ``told`` what was assumed.

    Raises:
        TargetError: the unit is not known, or makes an unusual size that is not confirmed.
    """
    longest = float(np.ptp(mesh.triangles, axis=(0, 1)).max())
    if not areas_m2(mesh.triangles).sum() > 0.0:
        raise TargetError(cad, "", NO_AREA)
    if options.units is not None and options.units not in METRES:
        raise TargetError(cad, "--units", f"is {options.units!r}; it must be one of {', '.join(METRES)}")
    by_unit = None if options.units is None else METRES[options.units]
    states_its_unit = cad.suffix.lower() in STEP
    if states_its_unit and by_unit is not None:
        if options.units not in ("m", *mesh.units) and options.longest_side_m is None:
            raise TargetError(cad, "--units", _own_unit(mesh, longest))
        by_unit = 1.0
    if by_unit is None and options.longest_side_m is None and cad.suffix.lower() in METRIC:
        told.append(_AS_STATED if states_its_unit else "the format is in metres")
        by_unit = 1.0
    if options.longest_side_m is not None:
        scale = options.longest_side_m / longest
        if by_unit is not None and abs(scale / by_unit - 1.0) > 0.01:
            told.append(
                f"by its unit the longest side is {by_unit * longest:.4g} m; it is scaled to "
                f"{options.longest_side_m:g} m"
            )
        return scale
    if by_unit is None:
        reason = f"is missing, and the file does not state its unit; its longest side is {longest:.4g} units"
        raise TargetError(cad, "--units", f"{reason}: {_usual(longest)}; or give --longest-side-m")
    if not usual_size(by_unit * longest) and not options.confirmed_size:
        raise TargetError(cad, "--units", _other_units(by_unit, longest, states_its_unit=states_its_unit))
    return by_unit


_AS_STATED = "the unit is the one that the file states"


def _own_unit(mesh: MeshFile, longest: float) -> str:
    """Return why a unit is refused that a STEP file does not name."""
    named = f" ({', '.join(mesh.units)})" if mesh.units else ""
    return (
        f"is not needed: the file states its own unit{named}, by which the longest side is {longest:.4g} m; "
        "leave --units out, or give --longest-side-m if this is wrong"
    )


def _other_units(by_unit: float, longest: float, *, states_its_unit: bool) -> str:
    """Return why a size is refused, with the units that would give a usual one."""
    reason = (
        f"the unit that the file states makes its longest side {longest:.4g} m"
        if states_its_unit
        else f"makes the target's longest side {by_unit * longest:.4g} m"
    )
    remedy = "give" if states_its_unit else f"{_usual(longest)}; or give"
    return (
        f"{reason}, and {SMALLEST_M} m to {LARGEST_M:.0f} m are usual: {remedy} --longest-side-m; if the "
        "size is right, give --confirm-size, which writes confirmed_size: true"
    )


def _usual(longest: float) -> str:
    """Return the usual sizes that a longest side has with the units, in words."""
    usual = [
        f"{scale * longest:.3g} m with {name}"
        for name, scale in METRES.items()
        if usual_size(scale * longest)
    ]
    return f"it is {', '.join(usual)}" if usual else "no unit makes it usual"


def most_sides(mesh: MeshFile) -> FloatArray:
    """Return the sides of the box that holds nearly all of a mesh's area, in its units, shape (3,).

    A drawing may have small things that were left over, far from the body.
    """
    area = np.repeat(areas_m2(mesh.triangles), 3)
    corners, sides = mesh.triangles.reshape(-1, 3), []
    for values in corners.T:
        order = np.argsort(values)
        share = np.cumsum(area[order]) / area.sum()
        low, high = np.searchsorted(share, (_LEFT_OVER, 1.0 - _LEFT_OVER))
        sides.append(values[order[high]] - values[order[low]])
    return np.array(sides)


def left_over(mesh: MeshFile, scale: float) -> list[str]:
    """Return a sentence about small things far from the body, if there are any."""
    whole, most = scale * np.ptp(mesh.triangles, axis=(0, 1)), scale * most_sides(mesh)
    if whole.max() <= _FAR * most.max():
        return []
    sides = " x ".join(f"{side:.3g}" for side in most)
    return [
        f"99.5 % of the surface is within {sides} m, but the whole file is {whole.max():.3g} m long: if the "
        "rest is left over from the drawing, delete it and write the target again"
    ]


def rounded(mesh: MeshFile, scale: float) -> list[str]:
    """Return a sentence if a file's 32-bit numbers are coarse, since the body is far from their origin."""
    farthest, longest = float(np.abs(mesh.triangles).max()), float(np.ptp(mesh.triangles, axis=(0, 1)).max())
    step = float(np.spacing(np.float32(farthest)))
    if step <= _COARSE * longest or not np.array_equal(mesh.triangles, mesh.triangles.astype(np.float32)):
        return []
    return [
        f"the file's origin is {scale * farthest:.3g} m away, and its numbers of 32 bits have steps of "
        f"{scale * step:.2g} m there: move the body to the origin in the CAD program and export it again"
    ]
