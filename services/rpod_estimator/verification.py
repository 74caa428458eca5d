"""Whether a registration is believed: cost, inliers and self-check against their limits.

f_MAX is the 2015 paper's failure detection (section 4.5); alone it accepts wrong poses on sparse
scans, so the share of rays or pixels on which model and measurement agree is asked as well.
"""

import math

from rpod_estimator.ports import Registration
from rpod_schemas.config.verification import VerificationConfig


def doubt(registration: Registration, limits: VerificationConfig) -> str:
    """Return why a registration is not believed, in words for the operator; empty if it is."""
    if registration.T_sensor_target is None:
        return registration.reason
    if not registration.cost_m2 <= limits.max_cost_m2:
        return f"cost {registration.cost_m2:.2g} m2 above {limits.max_cost_m2:.2g}"
    if registration.inliers < limits.min_inliers:
        return f"{registration.inliers} inliers, needs {limits.min_inliers}"
    if registration.inlier_share < limits.min_inlier_share:
        return f"inlier share {registration.inlier_share:.2f} below {limits.min_inlier_share:.2f}"
    explained = registration.explained_share
    if not math.isnan(explained) and explained < limits.min_explained_share:
        return f"explained share {explained:.2f} below {limits.min_explained_share:.2f}"
    return ""
