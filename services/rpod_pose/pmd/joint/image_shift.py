"""A start from the prediction, moved across the line of sight to where its image is found.

A search for edges reaches some pixels only. From a prediction that is farther off, edges match their
neighbours, and few depth points turn the target before they move it. The image of the whole target is found
at once: its rendering is compared with the frame at every shift by whole pixels (normalised correlation).
"""

import cv2
import numpy as np

from rpod_pose.pmd.joint.brightness.patch_renderer import Shown
from rpod_pose.pmd.joint.frame import MARGIN_PX, JointFrame
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.types import Float32Array


def found_in_image(seen: JointFrame, shown: Shown) -> PoseArrays:
    """Return the pose of a rendering, moved across the line of sight to where the image fits it best.

    The result is the same object if it fits best where it is, or if nothing tells.

    Both images are clipped at their median brightness, so that the outline counts more than glints do.

    Args:
        seen: the frame, around the pose.
        shown: the target rendered at a predicted pose.
    """
    patch, pose = seen.patch, shown.pose
    if not (patch.typical and shown.typical):  # no amplitude, or nothing in view
        return pose
    expected, (row, column, rows, columns) = np.zeros_like(patch.image), shown.window
    expected[row : row + rows, column : column + columns] = _clipped(shown.shade, shown.typical)
    image = np.pad(_clipped(patch.image, patch.typical), MARGIN_PX)
    alike = cv2.matchTemplate(image, expected, cv2.TM_CCOEFF_NORMED)
    down, across = np.array(np.unravel_index(int(alike.argmax()), alike.shape)) - MARGIN_PX
    if not (down or across):
        return pose
    step_m = seen.away_m * np.array((across / seen.lens.fx, down / seen.lens.fy, 0.0))
    return PoseArrays(pose.R, pose.t + step_m)


def _clipped(image: Float32Array, typical: float) -> Float32Array:
    """Return an image in units of its median brightness, at most 1."""
    clipped: Float32Array = np.minimum(image / np.float32(typical), np.float32(1.0))
    return clipped
