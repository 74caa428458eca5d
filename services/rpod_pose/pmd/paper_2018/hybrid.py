"""Both techniques of the 2018 paper on every frame, with a rule for the choice that needs no truth.

Klionovska et al., Robotics 7(1), 2018, compare the two afterwards and leave their fusion open (section 5).
Here each is accepted by the frame alone: depth by residual, inliers and the share of the depth image that its
pose explains; amplitude by points, reprojection error, covariance and distance from the prediction.

1. If one fails, the other alone gives the pose. With 60 % of the depth lost, the pose explains too little of
   the depth image to be accepted; the amplitude is not affected.
2. If the two agree within their covariances, they are fused, weighted with their information: PMD_JOINT.
   Their errors differ: uncalibrated depth has an error of about 25 mm along the line of sight and determines
   roll from outlines less well than amplitude does from corners; the tilt by amplitude depends on one circle.
3. If the two disagree, they are not fused, since one is wrong. The amplitude's pose is taken if it has enough
   redundant points, otherwise the depth's: four or five points fit almost anything, but a small reprojection
   error of six or seven is not a coincidence.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.pmd.paper_2018.epnp import EpnpTracker
from rpod_pose.pmd.paper_2018.icp_reverse_calibration import ReverseCalibrationIcp
from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.pmd.amplitude import HybridConfig
from rpod_schemas.types import PmdFrame, Source
from rpod_target import Target


class HybridTracker:
    """Registers frames by depth and by amplitude and chooses or fuses: ports.Tracker[PmdFrame].

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
        """Return the registration from a predicted pose, or both reasons why the frame gives none."""
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

    To first order, it is the first pose moved by P1 (P1 + P2)^-1 times the step (dp, dtheta) to the second.
    """
    assert first.T_sensor_target is not None  # noqa: S101 - guaranteed by the caller
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
    assert first.T_sensor_target is not None  # noqa: S101 - guaranteed by the caller
    assert second.T_sensor_target is not None  # noqa: S101 - guaranteed by the caller
    turn = second.T_sensor_target.rotation * first.T_sensor_target.rotation.inv()
    shift_m = second.T_sensor_target.translation - first.T_sensor_target.translation
    return np.concatenate((shift_m, turn.as_rotvec()))


def shifted(T_sensor_target: RigidTransform, step: FloatArray) -> RigidTransform:
    """Return the pose after a step (dp, dtheta) in the sensor's fixed axes, shape (6,)."""
    turn = Rotation.from_rotvec(step[3:])
    return RigidTransform.from_components(
        T_sensor_target.translation + step[:3], turn * T_sensor_target.rotation
    )
