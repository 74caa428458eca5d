"""Brightness of a target in any camera: the renderer of the PMD camera's light, without its modulation."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import Hits, RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera, Float32Array
from rpod_sim_sensor.pmd.light import Fragments, Lights, collect
from rpod_sim_sensor.pmd.scene import Scene
from rpod_sim_sensor.surroundings import scenery
from rpod_target import Target


@dataclass(frozen=True, eq=False)
class Illumination:
    """The light on a target, in the unit that a pixel collects (electrons, or any other)."""

    sun_W_m2: FloatArray
    """Unit vector to the sun times its irradiance in the camera's band, optical axes, shape (3,)."""
    collected_per_radiance: float
    """Amount that a pixel collects for a radiance of 1 W/m2/sr."""
    lamp_W_m2: float = 0.0
    """Irradiance of a lamp beside the lens at 1 m."""
    lamp_radius_m: float = 0.05


class Renderer:
    """Renders a target's brightness; its buffers are reused from image to image.

    Args:
        camera: intrinsics and distortion.
        target: shape and materials.
        subsamples: number of rays across a pixel, and down.

    Raises:
        rpod_geometry.errors.DistortionError: the lens has no inverse.
    """

    def __init__(self, camera: Camera, target: Target, *, subsamples: int = 2) -> None:
        self._target = target
        self._rays = RayGrid.pinhole(camera, subsamples).in_single_precision()
        self._centres = RayGrid.pinhole(camera).in_single_precision()
        self._scene = Scene(scenery(target, (), RigidTransform.identity()), 0)
        self._hits = Hits.of(self._rays)
        self._fragments = Fragments.of(self._rays.shape[1] * subsamples, 0)
        self._modulated = np.empty((0, *self._centres.shape), np.float32)

    def render(self, T_optical_target: RigidTransform, illumination: Illumination) -> Float32Array:
        """Return the amount that each pixel collects, shape (H, W); 0 on pixels that miss the target."""
        closed = self._target.field is not None
        cast(self._rays, self._target.triangles_m, T_optical_target, out=self._hits, cull_back_faces=closed)
        collected = np.empty(self._centres.shape, np.float32)
        collect(
            self._hits.triangle,
            self._rays.components,
            self._centres.components,
            self._scene.placed(T_optical_target, ()),
            _lights(illumination),
            fragments=self._fragments,
            modulated_e=self._modulated,
            charge_e=collected,
        )
        return collected


def _lights(illumination: Illumination) -> Lights:
    irradiance = float(np.linalg.norm(illumination.sun_W_m2))
    per_radiance = illumination.collected_per_radiance
    return Lights(
        lamp_e=illumination.lamp_W_m2 * per_radiance,
        lamp_radius_m=illumination.lamp_radius_m,
        turns_per_m=np.empty(0),
        theta_turns=np.empty(0),
        wiggling_share=0.0,
        sun_e=irradiance * per_radiance,
        sun_direction=np.asarray(illumination.sun_W_m2, float) / (irradiance or 1.0),
    )
