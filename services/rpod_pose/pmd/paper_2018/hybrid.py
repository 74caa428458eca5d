"""Both techniques of the 2018 paper on every frame, and which pose is taken: by a rule without the truth.

Klionovska et al., Robotics 7(1), 2018, compare the two in hindsight and leave their fusion open (section 5).
Here each is judged by the frame alone: the depth by residual, inliers and the share of the depth image that
its pose explains, the amplitude by points, reprojection error, covariance and distance from the prediction.

1. One that fails is left out: the other alone gives the pose. With 60 % of the depth lost the pose explains
   too little of the image for the depth to be believed; the amplitude goes on as if nothing were missing.
2. Two that agree within their covariances are fused, each weighted with its information: PMD_JOINT. They err
   differently: the depth has some 25 mm along the line of sight where it is not calibrated, and knows the
   roll worse from outlines than the amplitude from corners; the amplitude's tilt hangs on one circle.
3. Two that disagree are not fused, since one is wrong. The amplitude's pose is taken where it rests on enough
   points to contradict each other, else the depth's: four or five points fit almost anything, while a small
   reprojection error of six or seven is no accident.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.pmd.paper_2018.epnp import EpnpTracker
from rpod_pose.pmd.paper_2018.icp_reverse_calibration import ReverseCalibrationIcp
from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.pmd_amplitude import HybridConfig
from rpod_schemas.types import PmdFrame, Source
from rpod_target import Target


class HybridTracker:
    """Registers frames by depth and by amplitude and arbitrates: ports.Tracker[PmdFrame].

    Raises:
        rpod_target.TargetError: as ``ReverseCalibrationIcp``.
    """

    def __init__(self, config: HybridConfig, target: Target) -> None:
        self._config = config
        acceptance = AcceptanceConfig(
            max_cost_m2=config.max_depth_cost_m2,
            min_explained_share=config.min_explained_share,
            min_inlier_share=config.min_inlier_share,
        )
        self._depth = ReverseCalibrationIcp(
            config.depth.model_copy(update={"acceptance": acceptance}), target
        )
        self._amplitude = EpnpTracker(config.amplitude, target)

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or both reasons why there is none."""
        depth = self._depth.track(measurement, T_sensor_target)
        amplitude = self._amplitude.track(measurement, T_sensor_target)
        if not depth.begins_track and not amplitude.begins_track:
            reason = f"depth: {depth.belief.refusal}; amplitude: {amplitude.belief.refusal}"
            return Registration.none(Source.PMD_JOINT, reason)
        if not depth.begins_track:
            return amplitude
        if not amplitude.begins_track:
            return depth
        if squared_difference(depth, amplitude) <= self._config.agreement:
            return fused(depth, amplitude)
        return amplitude if amplitude.inliers >= self._config.redundant_points else depth


def squared_difference(first: Registration, second: Registration) -> float:
    """Return d^T (P1 + P2)^-1 d of the difference d of two poses with the covariances P1 and P2."""
    d = _difference(first, second)
    return float(d @ np.linalg.solve(first.covariance + second.covariance, d))


def fused(first: Registration, second: Registration) -> Registration:
    """Return the mean of two poses on SE(3), each weighted with its information.

    To the first order: from the first, by P1 (P1 + P2)^-1 of the way (dp, dtheta) to the second.
    """
    assert first.T_sensor_target is not None  # noqa: S101 - told by the caller
    gain = np.linalg.solve(first.covariance + second.covariance, first.covariance).T
    step = gain @ _difference(first, second)
    covariance = first.covariance - gain @ first.covariance
    return replace(
        first,
        source=Source.PMD_JOINT,
        T_sensor_target=shifted(first.T_sensor_target, step),
        covariance=(covariance + covariance.T) / 2.0,
        inliers=first.inliers + second.inliers,
    )


def _difference(first: Registration, second: Registration) -> FloatArray:
    """Return (dp, dtheta) from one pose to another in the sensor's fixed axes, shape (6,)."""
    assert first.T_sensor_target is not None  # noqa: S101 - told by the caller
    assert second.T_sensor_target is not None  # noqa: S101 - told by the caller
    turn = second.T_sensor_target.rotation * first.T_sensor_target.rotation.inv()
    shift_m = second.T_sensor_target.translation - first.T_sensor_target.translation
    return np.concatenate((shift_m, turn.as_rotvec()))


def shifted(T_sensor_target: RigidTransform, step: FloatArray) -> RigidTransform:
    """Return the pose after a step (dp, dtheta) in the sensor's fixed axes, shape (6,)."""
    turn = Rotation.from_rotvec(step[3:])
    return RigidTransform.from_components(
        T_sensor_target.translation + step[:3], turn * T_sensor_target.rotation
    )
