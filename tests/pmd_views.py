"""Frames of the PMD emulator at a pose: depth and amplitude as the camera sends them."""

from functools import cache

import numpy as np
from pmd_frames import CAMERA
from scipy.spatial.transform import RigidTransform

from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.types import Camera, PmdFrame
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

mockup = cache(lambda: load_target("mockup"))


@cache
def _emulator(distortion: tuple[float, ...]) -> PmdEmulator:
    camera = CAMERA.model_copy(update={"distortion": np.array(distortion)})
    return PmdEmulator(PmdConfig(camera=camera, subsamples=1), mockup(), seed=7)


def pmd_view(T_optical_target: RigidTransform, *, camera: Camera = CAMERA, number: int = 0) -> PmdFrame:
    """Return a frame of the mock-up at rest, in the dark."""
    emulator = _emulator(tuple(camera.distortion.tolist()))
    exposure = emulator.expose([T_optical_target] * 4, sun_W_m2=np.zeros(3), frame=number)
    return PmdFrame(
        stamp_ns=0,
        frame_id="pmd_optical",
        depth_m=exposure.depth_m.copy(),
        amplitude=exposure.amplitude.copy(),
        camera=camera,
    )
