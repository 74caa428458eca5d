"""Variations of a target: models that differ from it as an engineer's model differs from what flies.

A variation is written behind a target's name or file: ``mockup@bent=5deg``, ``my.yaml@coarse=2%@scale=-1%``.
It moves the corners of all surfaces, so that it works for any target, and keeps the axes.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import radians
from typing import Annotated, Any

import numpy as np
from numpy.random import Generator
from pydantic import Field, field_validator
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.base import Config
from rpod_target.mesh.topology import areas_m2

SIGN = "@"
_TERM = re.compile(r"@([A-Za-z_]+)(?:=([^@/]*))?$")
_QUANTITY = re.compile(r"^([-+]?[0-9]*\.?[0-9]+)(deg|mm|m|%)$")
_UNITS = {"deg": radians(1.0), "mm": 1e-3, "m": 1.0, "%": 0.01}
_WAVES, _WAVELENGTHS = 12, (0.4, 1.2)
"""Number of waves of the displacement, and their least and greatest length over the target's longest side."""
_PLANES, _ROOT = 33, (0.0, 0.8)
"""Number of plane cuts across each direction, and places of the first and the last one, over the extent."""


def _in(unit: str) -> Any:
    """Return the validator of a quantity: a text such as 5deg, in SI, with a unit of the same kind."""
    alike = {"deg": ("deg",), "mm": ("mm", "m"), "%": ("%",)}[unit]

    def read(cls: type, text: Any) -> Any:  # noqa: ARG001 - a validator of a class
        if not isinstance(text, str):
            return text
        found = _QUANTITY.match(text)
        if found is None or found[2] not in alike:
            raise ValueError(f"needs a number with its unit ({' or '.join(alike)}), not {text!r}")
        return float(found[1]) * _UNITS[found[2]]

    return read


class Variation(Config):
    """Differences of a model from a target. Each field is a term, such as ``@bent=5deg``."""

    bent: Annotated[float, Field(ge=-0.8, le=0.8)] = 0.0
    """Angle, ``deg``, by which the longest thin end, such as a solar array, is bent at its root."""
    missing: bool = False
    """Whether that end is missing: ``@missing``."""
    without: tuple[str, ...] = ()
    """Names of parts that are left out; one each term: ``@without=nose``."""
    off: Annotated[float, Field(ge=0)] = 0.0
    """RMS distance, ``mm`` or ``m``, by which places are off in random directions; near places have
    nearly the same offset."""
    scale: Annotated[float, Field(gt=-0.5, lt=1)] = 0.0
    """Share, ``%``, by which the model is larger than the target, about the origin."""
    coarse: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Error, ``%`` of the longest side, up to which surfaces are simplified."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of the random directions."""

    _bent = field_validator("bent", mode="before")(_in("deg"))
    _off = field_validator("off", mode="before")(_in("mm"))
    _shares = field_validator("scale", "coarse", mode="before")(_in("%"))

    def moved(self, surfaces_m: Sequence[FloatArray]) -> list[FloatArray]:
        """Return the corners of all surfaces, each of shape (T, 3, 3), after the variation.

        Triangles of a missing end have no area, or close the gap.
        """
        generator = np.random.default_rng(self.seed)
        every_m = np.concatenate(surfaces_m)
        size_m = float(np.ptp(every_m, axis=(0, 1)).max())
        waves = _Waves.drawn(generator, size_m)
        root = _Root.of(every_m) if self.bent or self.missing else None
        hinge = generator.standard_normal(3)

        def vary(corners_m: FloatArray) -> FloatArray:
            result = corners_m.copy()
            if root is not None:
                end = root.beyond(corners_m)
                if self.missing:
                    result[end] = root.centre_m
                else:
                    result[end] = root.turned(corners_m[end], hinge, self.bent)
            moved: FloatArray = (1.0 + self.scale) * result + self.off * waves.at(corners_m)
            return moved

        return [vary(surface_m.reshape(-1, 3)).reshape(-1, 3, 3) for surface_m in surfaces_m]


def split(name_or_path: str) -> tuple[str, dict[str, Any]]:
    """Return a target's name or file without the terms behind it, and these, as a variation's fields."""
    terms: dict[str, Any] = {}
    while found := _TERM.search(name_or_path):
        name_or_path = name_or_path[: found.start()]
        name, value = found[1], True if found[2] is None else found[2]
        terms[name] = (value, *terms.get(name, ())) if name == "without" else value
    return name_or_path, dict(reversed(terms.items()))


@dataclass(frozen=True, eq=False)
class _Waves:
    """A smooth displacement of 1 m RMS: waves of random direction, length and phase."""

    k: FloatArray
    """Wave vectors, shape (W, 3), rad/m."""
    phase: FloatArray
    """Phases, shape (W,)."""
    amplitude_m: FloatArray
    """Amplitudes, shape (W, 3)."""

    @classmethod
    def drawn(cls, generator: Generator, size_m: float) -> "_Waves":
        """Return waves for a target of a size."""
        direction = generator.standard_normal((_WAVES, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        length_m = size_m * generator.uniform(*_WAVELENGTHS, (_WAVES, 1))
        phase = generator.uniform(0.0, 2.0 * np.pi, _WAVES)
        amplitude = generator.standard_normal((_WAVES, 3))
        amplitude *= np.sqrt(2.0) / np.linalg.norm(amplitude)
        return cls(2.0 * np.pi * direction / length_m, phase, amplitude)

    def at(self, points_m: FloatArray) -> FloatArray:
        """Return the displacement at points, shape (N, 3)."""
        displacement: FloatArray = np.cos(points_m @ self.k.T + self.phase) @ self.amplitude_m
        return displacement


@dataclass(frozen=True, eq=False)
class _Root:
    """The narrow root of an end that sticks out of a target, such as an array's arm."""

    centre_m: FloatArray
    """Middle of the outline of the cut, shape (3,)."""
    direction: FloatArray
    """Unit vector to the end, shape (3,)."""

    @classmethod
    def of(cls, triangles_m: FloatArray) -> "_Root":
        """Return the root with the longest end over the length of the cut's outline, of many plane cuts."""
        area_m2 = areas_m2(triangles_m)
        middle_m = area_m2 @ triangles_m.mean(axis=1) / area_m2.sum()
        longest, found = 0.0, None
        for way in product((-1.0, 0.0, 1.0), repeat=3):
            if not any(way):
                continue
            direction = np.array(way) / np.linalg.norm(way)
            height_m = (triangles_m - middle_m) @ direction
            least_m, greatest_m, reach_m = height_m.min(axis=1), height_m.max(axis=1), float(height_m.max())
            for share in np.linspace(*_ROOT, _PLANES):
                crossed = (least_m < share * reach_m) & (share * reach_m < greatest_m)
                outline_m, centre_m = _cut(triangles_m[crossed], height_m[crossed] - share * reach_m)
                if outline_m > 0.0 and (1.0 - share) * reach_m > longest * outline_m:
                    longest = (1.0 - share) * reach_m / outline_m
                    found = cls(centre_m, direction)
        if found is None:
            raise ValueError("has no thin end that could be bent or missing; choose another variation")
        return found

    def beyond(self, points_m: FloatArray) -> Any:
        """Return which points, (N, 3), belong to the end, shape (N,)."""
        return (points_m - self.centre_m) @ self.direction > 0.0

    def turned(self, points_m: FloatArray, hinge: FloatArray, angle_rad: float) -> FloatArray:
        """Return points turned about the hinge: the part of a vector that is across the end."""
        axis = hinge - (hinge @ self.direction) * self.direction
        turn = Rotation.from_rotvec(angle_rad * axis / np.linalg.norm(axis))
        turned_m: FloatArray = self.centre_m + turn.apply(points_m - self.centre_m)
        return turned_m


def _cut(triangles_m: FloatArray, height_m: FloatArray) -> tuple[float, FloatArray]:
    """Return the length of the outline in which a plane cuts triangles, m, and the outline's middle, m.

    Args:
        triangles_m: triangles that the plane crosses, shape (T, 3, 3).
        height_m: heights of their corners over the plane, shape (T, 3).
    """
    crosses = (height_m > 0.0) != (np.roll(height_m, -1, axis=1) > 0.0)  # two edges of each triangle
    next_m, next_height_m = np.roll(triangles_m, -1, axis=1)[crosses], np.roll(height_m, -1, axis=1)[crosses]
    share = height_m[crosses] / (height_m[crosses] - next_height_m)
    ends_m = (triangles_m[crosses] + share[:, None] * (next_m - triangles_m[crosses])).reshape(-1, 2, 3)
    length_m = np.linalg.norm(ends_m[:, 1] - ends_m[:, 0], axis=1)
    total_m = float(length_m.sum())
    if total_m == 0.0:
        return 0.0, np.zeros(3)
    middle_m: FloatArray = length_m @ ends_m.mean(axis=1) / total_m
    return total_m, middle_m
