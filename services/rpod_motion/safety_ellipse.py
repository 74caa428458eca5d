"""Positions along a safety ellipse at which campaigns try an acquisition.

Source: Opromolla et al., Sensors 15(3), 2015, sections 3.3 and 4.3 (Fig. 5): 241 positions, 50 s apart, over
two orbits of ENVISAT, at ranges from about 25 to 53 m. The paper states neither how the target rotates
meanwhile nor where on its orbit it starts: both are parameters.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_motion.motion import build_motion
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import AttitudeConfig, MotionConfig, StationKeepingConfig

POSITIONS = 241
STEP_S = 50.0
PAPER_ELLIPSE = StationKeepingConfig(least_range_m=25.0, greatest_range_m=53.0)


def safety_ellipse_positions(
    attitude: AttitudeConfig,
    *,
    centre_of_mass_m: FloatArray,
    inertia_kg_m2: FloatArray,
    trajectory: StationKeepingConfig = PAPER_ELLIPSE,
) -> tuple[FloatArray, RigidTransform]:
    """Return times from the epoch, s, shape (241,), and T_chaser_target at them, 241 poses.

    The chaser's z axis, the boresight, points at the target's centre of mass. The result is deterministic.

    Args:
        attitude: rotation of the target.
        centre_of_mass_m: centre of mass, target axes, shape (3,).
        inertia_kg_m2: inertia about the centre of mass, target axes, shape (3, 3); used by a tumbling target.
        trajectory: the ellipse.

    Raises:
        MotionError: the target tumbles, and its inertia is not that of a rigid body.
    """
    times_s: FloatArray = np.linspace(0.0, STEP_S * (POSITIONS - 1), POSITIONS)
    motion = build_motion(
        MotionConfig(trajectory=trajectory, attitude=attitude),
        centre_of_mass_m=centre_of_mass_m,
        inertia_kg_m2=inertia_kg_m2,
        duration_s=float(times_s[-1]),
    )
    poses = [motion.state(time_s).T_chaser_target for time_s in times_s.tolist()]
    return times_s, RigidTransform.concatenate(poses)
