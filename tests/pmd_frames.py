"""Depth images without an emulator: rays cast at a target, noise where asked for."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.types import Camera, PmdFrame
from rpod_target import Target

CAMERA = Camera(width=352, height=287, fx=682.75, fy=691.42, cx=175.5, cy=143.0)
TINY = Camera(width=2, height=3, fx=5.0, fy=5.0, cx=0.5, cy=1.0)


def depth_frame(
    target: Target,
    T_optical_target: RigidTransform,
    *,
    noise_m: float = 0.0,
    camera: Camera = CAMERA,
    seed: int = 0,
) -> PmdFrame:
    """Return what an ideal depth camera sees, with white noise along the boresight."""
    rays = RayGrid.pinhole(camera)
    depth_m = cast(rays, target.triangles_m, T_optical_target).range_m * rays.components[2]
    noise = noise_m * np.random.default_rng(seed).standard_normal(depth_m.shape)
    return frame_of(np.where(np.isfinite(depth_m), depth_m + noise, np.nan), camera=camera)


def frame_of(depth_m: object, *, amplitude: object = None, camera: Camera = CAMERA) -> PmdFrame:
    """Return a frame of a depth image, or of one value everywhere."""
    size = (camera.height, camera.width)
    image = np.ascontiguousarray(np.broadcast_to(np.asarray(depth_m, np.float32), size))
    shade = None if amplitude is None else np.ascontiguousarray(np.broadcast_to(amplitude, size))
    return PmdFrame(stamp_ns=0, frame_id="pmd_optical", depth_m=image, amplitude=shade, camera=camera)


def strange_frames() -> dict[str, PmdFrame]:
    """Return frames that show no target, or nothing that a camera could have seen."""
    rng = np.random.default_rng(5)
    folded = CAMERA.model_copy(update={"distortion": np.array([-9.0, 0.0, 0.0, 0.0, 0.0])})
    fisheye = CAMERA.model_copy(update={"distortion": np.full(9, 0.1)})
    unnamed = TINY.model_copy(update={"distortion": np.zeros(0)})
    noise = rng.uniform(0.1, 9.0, (CAMERA.height, CAMERA.width))
    return {
        "nothing": frame_of(np.nan),
        "zero": frame_of(0.0),
        "negative": frame_of(-3.0),
        "infinite": frame_of(np.inf),
        "a wall": frame_of(4.0),
        "a near wall": frame_of(1e-3),
        "a far wall": frame_of(1e6),
        "noise": frame_of(noise, amplitude=np.zeros((CAMERA.height, CAMERA.width), np.uint16)),
        "tiny": frame_of(4.0, camera=TINY),
        "a lens that folds the image": frame_of(4.0, camera=folded),
        "a lens of another model": frame_of(4.0, camera=fisheye),
        "a lens without coefficients": frame_of(4.0, camera=unnamed),
    }
