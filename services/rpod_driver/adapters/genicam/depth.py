"""Depth of a buffer's components (SFNC 2.7, chapter 3D scan control; PFNC 2.4, Coord3D formats)."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_driver.adapters.genicam.features import FeatureError, read, write
from rpod_schemas.types import Camera, Float32Array

_METRES = {"Millimeter": 1e-3, "Meter": 1.0, "Inch": 0.0254}
_Z_MODES = ("CalibratedABC_Grid", "CalibratedC", "ProjectedC")
"""Output modes that are the image of a pinhole and in which coordinate C is the distance along z.

SFNC 2.7.1: the rectified modes are sampled uniformly in X and Y, not along rays, and the points of
``CalibratedABC_PointCloud`` have no place in an image."""
_ENABLE = "set ComponentSelector: Range and ComponentEnable: true in device.settings"
_C_PLANE = {"Coord3D_C8", "Coord3D_C16", "Coord3D_C32f"}
_ABC = {"Coord3D_ABC8", "Coord3D_ABC16", "Coord3D_ABC32f"}
_AMPLITUDES = {"Mono8": np.uint8, "Mono10": np.uint16, "Mono12": np.uint16, "Mono16": np.uint16}
_CONFIDENCES = {"Confidence8", "Confidence16", "Confidence1"}


class Scan3d:
    """Description of a camera's coordinates; read once a connection."""

    def __init__(self, nodes: Any, calibration: Camera | None) -> None:
        """Read the features. Raises ``FeatureError`` for coordinates that are no depth."""
        mode, system = read(nodes, "Scan3dOutputMode"), read(nodes, "Scan3dCoordinateSystem")
        unit = read(nodes, "Scan3dDistanceUnit")
        if mode not in (None, *_Z_MODES):
            raise FeatureError(
                f"Scan3dOutputMode is {mode}, which is no z-depth in an image of a pinhole; set one of "
                f"{', '.join(_Z_MODES)} in device.settings"
            )
        if system not in (None, "Cartesian"):
            raise FeatureError(
                f"Scan3dCoordinateSystem is {system}; set Cartesian in device.settings, or another mode"
            )
        if unit not in _METRES:
            raise FeatureError(
                f"Scan3dDistanceUnit is {unit}, known are {', '.join(_METRES)}; without one there is no "
                f"depth: {_ENABLE}"
            )
        if nodes.has_node("Scan3dCoordinateSelector"):
            write(nodes, "Scan3dCoordinateSelector", "CoordinateC")
        metres = _METRES[str(unit)]
        self.scale_m = metres * float(read(nodes, "Scan3dCoordinateScale") or 1.0)
        self.offset_m = metres * float(read(nodes, "Scan3dCoordinateOffset") or 0.0)
        invalid = read(nodes, "Scan3dInvalidDataFlag")
        self.invalid = float(read(nodes, "Scan3dInvalidDataValue") or 0.0) if invalid else None
        self._lens = calibration or _lens(nodes)

    def camera(self, width: int, height: int) -> Camera:
        """Return the lens. Raises ``FeatureError`` if it is unknown, or for another size."""
        lens = self._lens
        if lens is None:
            raise FeatureError(
                "the camera has no Scan3dFocalLength and Scan3dPrincipalPoint; calibrate it, and give the "
                "lens as device.calibration"
            )
        if (lens.width, lens.height) != (width, height):
            raise FeatureError(
                f"the lens is for {lens.width} x {lens.height} pixels, the camera sends {width} x {height}; "
                "calibrate it in this mode"
            )
        return lens


def _lens(nodes: Any) -> Camera | None:
    """Return the lens of SFNC 2.5 and later: focal length and principal point in pixels, no distortion."""
    names = ("Scan3dFocalLength", "Scan3dPrincipalPointU", "Scan3dPrincipalPointV", "Width", "Height")
    f, u, v, width, height = (read(nodes, name) for name in names)
    if not f or u is None or v is None:
        return None
    return Camera(width=width, height=height, fx=f, fy=f, cx=u, cy=v)


def depth_of(components: Iterable[Any], scan: Scan3d) -> Float32Array:
    """Return z-depth, m, shape (height, width), NaN where there is none.

    Raises:
        FeatureError: no component holds it; names those that came.
    """
    told = []
    for each in components:
        told.append(f"{each.data_format} {each.width} x {each.height}")
        plane = _plane(each)
        if plane is not None:
            valid = np.isfinite(plane) & (plane != scan.invalid if scan.invalid is not None else True)
            depth_m = plane.astype(np.float64) * scan.scale_m + scan.offset_m
            return np.where(valid & (depth_m > 0.0), depth_m, np.nan).astype(np.float32)
    raise FeatureError(
        f"the buffer holds {', '.join(told) or 'nothing'} and no coordinate C (Coord3D_C, Coord3D_ABC); "
        f"{_ENABLE}"
    )


def _plane(component: Any) -> NDArray[Any] | None:
    shape = (component.height, component.width)
    if component.data_format in _C_PLANE:
        return np.asarray(component.data).reshape(shape)
    if component.data_format in _ABC:
        return np.asarray(component.data).reshape(*shape, 3)[..., 2]
    return None


def amplitude_of(components: Iterable[Any]) -> NDArray[Any] | None:
    """Return the intensity image, uint8 or uint16, shape (height, width); None if there is no grey one."""
    for each in components:
        if each.data_format in _AMPLITUDES:
            return (
                np.asarray(each.data).reshape(each.height, each.width).astype(_AMPLITUDES[each.data_format])
            )
    return None


def confident(components: Iterable[Any]) -> NDArray[np.bool_] | None:
    """Return the pixels that a confidence image does not refuse (0), shape (height, width); None without."""
    for each in components:
        if each.data_format in _CONFIDENCES:
            kept: NDArray[np.bool_] = np.asarray(each.data).reshape(each.height, each.width) > 0
            return kept
    return None
