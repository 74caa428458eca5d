"""Errors at the frames that the target's file names, such as the launch adapter."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_analysis.log import Log
from rpod_analysis.log.targets import logged_targets
from rpod_schemas.arrays import FloatArray
from rpod_schemas.topics import ESTIMATE_FRAME
from rpod_target import TargetError, load_target


class NamedFrame(NamedTuple):
    """A frame of the target, T_target_frame."""

    model: RigidTransform
    """Pose in the model, by which the estimator publishes it."""
    truth: RigidTransform
    """Pose in the target that is seen; that of the model if the target's file does not name the frame."""


def named_frames(log: Log, *, prefix: str) -> dict[str, NamedFrame]:
    """Return the frames whose poses an estimator published, by name; none if the targets cannot be loaded.

    Args:
        log: the log.
        prefix: first part of the estimator's topics.
    """
    topics = ESTIMATE_FRAME.under(prefix).at("").name
    published = {name.removeprefix(topics) for name in log.topics if name.startswith(topics)}
    names = logged_targets(log, prefix=prefix)
    if not published or names.shown is None:
        return {}
    try:
        truth, model = load_target(names.shown).frames, load_target(names.model or names.shown).frames
    except TargetError:
        return {}
    return {
        name: NamedFrame(pose, truth.get(name, pose)) for name, pose in model.items() if name in published
    }


def frame_errors(
    frame: NamedFrame, T_estimate: RigidTransform, T_truth: RigidTransform
) -> tuple[FloatArray, FloatArray]:
    """Return the attitude error, deg, and the position error, m, of a frame in N estimates, shape (N,) each.

    Args:
        frame: the frame.
        T_estimate: estimated T_chaser_target, N poses.
        T_truth: true T_chaser_target, N poses.
    """
    estimate, truth = T_estimate * frame.model, T_truth * frame.truth
    angle_deg = np.rad2deg((truth.rotation.inv() * estimate.rotation).magnitude())
    distance_m: FloatArray = np.linalg.norm(estimate.translation - truth.translation, axis=1)
    return angle_deg, distance_m
