"""Acquisition by OpenCV's point pair features (Drost, Ulrich, Navab, Ilic, CVPR 2010)."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from peers.benchmark import Register, Scene
from peers.clouds import Cloud, model_cloud, scan_cloud
from rpod_schemas.types import LidarScan

MODEL_SPACING_M = 0.9
"""Spacing of the model's points; the best of 0.7, 0.9 and 1.2. Finer ones take seconds a scan."""
MODEL_STEP = 0.08
"""Sampling and distance step over the model's diameter; of 0.06 and 0.08."""
SCENE_SHARE = 0.2
"""Share of the scan's points that are references; the best of 0.2 and 1."""
SCENE_STEP = 0.05
"""Sampling of the scan over the model's diameter; of 0.03 and 0.05."""
ANGLES = 30
MIN_POINTS = 10
"""Fewer returns have no normals to speak of."""

SETUP = (
    f"scan normals by 8 neighbours, turned to the sensor; model points every {MODEL_SPACING_M:g} m, "
    f"model step {MODEL_STEP:g} and scan step {SCENE_STEP:g} of the diameter, "
    f"{SCENE_SHARE:g} of the returns as references (all tuned), {ANGLES} angles; the pose with most votes"
)


def point_pairs(scene: Scene) -> Register[LidarScan]:
    """Return the detector, trained on the whole surface."""
    contrib: Any = cv2  # whose types are not those of the plain build
    detector = contrib.ppf_match_3d_PPF3DDetector(MODEL_STEP, MODEL_STEP, ANGLES)
    detector.trainModel(_six_columns(model_cloud(scene.target, MODEL_SPACING_M)))

    def register(scan: LidarScan, _: RigidTransform) -> RigidTransform | None:
        if len(scan.returns_m) < MIN_POINTS:
            return None
        found = detector.match(_six_columns(scan_cloud(scan)), SCENE_SHARE, SCENE_STEP)
        return RigidTransform.from_matrix(found[0].pose) if found else None

    return register


def _six_columns(cloud: Cloud) -> NDArray[np.float32]:
    """Return positions and normals, shape (N, 6), as the detector takes them."""
    return np.hstack(cloud).astype(np.float32)
