"""Errors of the angles of the target's joints."""

import numpy as np
from numpy.typing import NDArray

from rpod_analysis.log import Log
from rpod_schemas.arrays import FloatArray
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_joints
from rpod_schemas.summary import ErrorSize
from rpod_schemas.topics import ESTIMATE_JOINTS, TRUTH_JOINTS


def joint_errors(log: Log, *, prefix: str) -> dict[str, ErrorSize]:
    """Return the errors, deg, of the estimated angle of each joint whose true angle is in the log, by name.

    The truth is interpolated at the stamps of the estimates; before and after it nothing is scored.

    Args:
        log: the log.
        prefix: first part of the estimator's topics.
    """
    truth, estimates = (_angles(log, topic.name) for topic in (TRUTH_JOINTS, ESTIMATE_JOINTS.under(prefix)))
    found = {}
    for name in truth.keys() & estimates.keys():
        (true_ns, true_rad), (stamp_ns, angle_rad) = truth[name], estimates[name]
        scored = (stamp_ns >= true_ns[0]) & (stamp_ns <= true_ns[-1])
        if scored.any():
            expected_rad = np.interp(stamp_ns[scored] - true_ns[0], true_ns - true_ns[0], true_rad)
            off_deg = np.abs(np.rad2deg(angle_rad[scored] - expected_rad))
            rms = float(np.sqrt(np.mean(off_deg**2)))
            found[name] = ErrorSize(rms=rms, p95=float(np.quantile(off_deg, 0.95)), max=float(off_deg.max()))
    return dict(sorted(found.items()))


def _angles(log: Log, topic: str) -> dict[str, tuple[NDArray[np.int64], FloatArray]]:
    """Return stamps, ns, and angles, rad, of each joint in a topic, in the order of the stamps."""
    rows: dict[str, list[tuple[int, float]]] = {}
    for logged in log.messages(topic) if topic in log.topics else ():
        try:
            joints = read_joints(logged.decode())
        except MessageRejectedError:  # counted where the run is read
            continue
        for name, angle_rad in joints.angle_rad.items():
            rows.setdefault(name, []).append((joints.stamp_ns, angle_rad))
    columns = {name: zip(*sorted(found), strict=True) for name, found in rows.items()}
    return {name: (np.array(stamps), np.array(angles)) for name, (stamps, angles) in columns.items()}
