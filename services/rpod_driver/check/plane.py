"""Tells z-depth (along the boresight) from radial depth (along each ray), by a plane in view.

A plane is flat under the right meaning and curved under the other one. The test compares how flat the largest
plane is under both. If the plane is too small or the lens too narrow for the noise, there is no result.
"""

import numpy as np
from numpy.typing import NDArray

from rpod_driver.check.observations import Observations
from rpod_driver.check.result import CheckResult, fail, ok, unchecked
from rpod_geometry.errors import DistortionError
from rpod_geometry.lens import ray_cosines, undistort
from rpod_geometry.planes import fitted_plane, largest_plane
from rpod_schemas.arrays import MAD_TO_SIGMA
from rpod_schemas.types import Camera, PmdFrame

Points = NDArray[np.float64]
_FRAMES, _PIXELS, _TRIALS = 12, 4000, 200
_LEAST_SHARE = 0.1
"""Share of a frame's pixels that make a plane."""
_NOISES = 3.0
"""Distance of a plane's points from it, over their noise."""
_CONTRAST = 0.5
"""Least curvature under the wrong meaning, over the noise, that is visible."""
_CURVED = 0.25, 2.0
"""Limits of the difference of both mean squares, over the squared curvature of a plane that is read wrongly:
a plane has 1. Beyond them the surface is no plane, or its noise hides the difference."""
_LEAST_FRAMES, _AGREE = 3, 0.8
"""Least number of frames that show a plane, and least share of them that agree: successive frames show the
same place."""


def depth_model(seen: Observations) -> CheckResult:
    """Check whether depth is z-depth, on planes in view."""
    line = "depth_model"
    frames = [kept.frame for kept in seen.kept if isinstance(kept.frame, PmdFrame)]
    if not frames:
        return unchecked(line, "no frame with a depth image could be read")
    few = frames[:: len(frames) // _FRAMES + 1]
    flatness = [result for frame in few if (result := _flatness(frame)) is not None]
    found = np.array([each for each in flatness if _CURVED[0] < abs(_curved(*each)) < _CURVED[1]])
    if len(found) < _LEAST_FRAMES:
        text = f"{len(found)} of {len(few)} frames show a plane wide enough for its noise"
        return unchecked(line, f"{text}, {_LEAST_FRAMES} are needed; show it a wall")
    as_z, as_radial, _ = np.median(found, axis=0)
    figures = {"rms_z_m": float(as_z), "rms_radial_m": float(as_radial)}
    text = (
        f"the plane in view is flat to {1e3 * as_z:.1f} mm as z-depth, "
        f"{1e3 * as_radial:.1f} mm as radial depth"
    )
    radial = float(np.mean(found[:, 0] > found[:, 1]))
    if max(radial, 1.0 - radial) < _AGREE:
        return unchecked(line, f"{text}: frames do not agree; show it a wall", **figures)
    return fail(line, text, "radial_depth", **figures) if radial > _AGREE else ok(line, text, **figures)


def _curved(as_z: float, as_radial: float, contrast: float) -> float:
    """Return how much flatter a surface is as z-depth, relative to a plane: 1 for z-depth, -1 for radial."""
    return (as_radial**2 - as_z**2) / contrast**2


def _flatness(frame: PmdFrame) -> tuple[float, float, float] | None:
    """Return the deviation from the largest plane as z-depth, as radial depth, and how far they differ, m."""
    try:
        slopes, cosines = _rays(frame.camera)
    except DistortionError:
        return None
    depth_m = frame.depth_m.astype(np.float64)
    noise_m = _noise_m(depth_m)
    valid = np.flatnonzero(np.isfinite(depth_m.ravel()) & (depth_m.ravel() > 0.0))
    if valid.size < 500 or not np.isfinite(noise_m):
        return None
    some = valid[:: valid.size // _PIXELS + 1]
    rays = slopes.reshape(3, -1)[:, some]
    as_z = (rays * depth_m.ravel()[some]).T
    as_radial = as_z * cosines.ravel()[some][:, None]
    inside = np.zeros(len(some), bool)
    within_m = _NOISES * max(noise_m, 1e-3)
    for points in (as_z, as_radial):
        plane = largest_plane(points, within_m, draws=_TRIALS, generator=np.random.default_rng(0))
        if plane is not None:
            inside |= plane.distances_m(points) < within_m
    if np.count_nonzero(inside) < _LEAST_SHARE * len(some):
        return None
    flat_z, flat_radial = (_deviation_m(points[inside]) for points in (as_z, as_radial))
    better = as_z if flat_z < flat_radial else as_radial
    factor = 1.0 / cosines.ravel()[some][inside] if better is as_radial else cosines.ravel()[some][inside]
    contrast = _deviation_m(_projected(better[inside]) * factor[:, None])
    return (flat_z, flat_radial, contrast) if contrast > _CONTRAST * noise_m else None


def _rays(camera: Camera) -> tuple[Points, Points]:
    """Return x/z, y/z, 1 of each pixel, shape (3, height, width), and its cosine to the boresight."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    distorted = np.stack(((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy))
    x, y = undistort(distorted.astype(np.float64), camera)
    return np.stack((x, y, np.ones_like(x))), ray_cosines(camera)


def _noise_m(depth_m: Points) -> float:
    """Return the noise of a depth image from its second differences along rows, m."""
    second = depth_m[:, 2:] - 2.0 * depth_m[:, 1:-1] + depth_m[:, :-2]
    second = second[np.isfinite(second)]
    return float(MAD_TO_SIGMA * np.median(np.abs(second)) / np.sqrt(6.0)) if second.size else float("nan")


def _deviation_m(points_m: Points) -> float:
    """Return the deviation of points from their plane, robust against a few outliers, m."""
    off_m = fitted_plane(points_m).distances_m(points_m)
    plane = fitted_plane(points_m[off_m <= 3.0 * np.median(off_m) + 1e-12])
    return float(MAD_TO_SIGMA * np.median(plane.distances_m(points_m)))


def _projected(points_m: Points) -> Points:
    """Return points on their plane, along their rays."""
    centre, normal = fitted_plane(points_m)
    along = points_m @ normal
    scale = np.where(np.abs(along) > 1e-9, (centre @ normal) / np.where(along == 0, 1.0, along), 1.0)
    flat: Points = points_m * scale[:, None]
    return flat
