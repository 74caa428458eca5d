"""``python -m truth_error LOG``: NEES against the logged exact truth, and against it with errors, by seed.

The estimates of each log are scored as the report scores them: the covariance of the truth is added to that
of the estimate. An interval over seeds shows what the errors of the truth alone make of one run.
"""

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis import open_log
from rpod_analysis.scoring.score import NEES_95, Track, find_errors
from rpod_motion.truth_error import TruthError
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import TruthErrorConfig
from rpod_schemas.messages import read_odometry
from rpod_schemas.topics import ESTIMATE, TRUTH, Topic


def main() -> None:
    """Score each log and print a line for each truth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--sigma-mm", type=float, default=1.56)
    parser.add_argument("--sigma-deg", type=float, default=0.2)
    given = parser.parse_args()
    console = Console(soft_wrap=True, highlight=False)
    for path in given.logs:
        truth, estimates = _track(path, TRUTH), _track(path, ESTIMATE)
        console.print(
            f"{path.name}, {len(estimates)} estimates: exact truth {_mean(_nees(estimates, truth)):.2f}"
        )
        for correlation_s in (0.0, 1.0):
            config = TruthErrorConfig(
                sigma_position_m=1e-3 * given.sigma_mm,
                sigma_attitude_deg=given.sigma_deg,
                correlation_s=correlation_s,
            )
            seeds = range(1, given.seeds + 1)
            nees = np.stack([_nees(estimates, _perturbed(truth, config, seed)) for seed in seeds])
            console.print(f"  errors over {correlation_s:g} s, {given.seeds} seeds: {_told(nees)}")


def _track(path: Path, topic: Topic) -> Track:
    with open_log(path) as log:
        read = [read_odometry(logged.decode()) for logged in log.messages(topic)]
    poses = RigidTransform.from_matrix(np.stack([each.pose.as_matrix() for each in read]))
    covariance = np.stack([each.pose_covariance for each in read])
    return Track(np.array([each.stamp_ns for each in read], np.int64), poses, covariance)


def _perturbed(truth: Track, config: TruthErrorConfig, seed: int) -> Track:
    rate_hz = 1e9 / float(np.median(np.diff(truth.stamp_ns)))
    error = TruthError(config, seed=seed, rate_hz=rate_hz)
    poses = RigidTransform.from_matrix(np.stack([error.perturb(pose).as_matrix() for pose in truth.poses]))
    return Track(truth.stamp_ns, poses, np.tile(error.covariance, (len(truth), 1, 1)))


def _nees(estimates: Track, truth: Track) -> FloatArray:
    covariance = estimates.covariance
    if covariance is None:
        raise TypeError("the estimates have no covariance")
    axes = Rotation.from_quat(np.tile((0.0, 0.0, 0.0, 1.0), (len(estimates), 1)))
    return find_errors(estimates, truth, covariance=covariance, R_chaser_sensor=axes)[0].nees


def _mean(nees: FloatArray) -> float:
    return float(np.nanmean(nees))


def _told(nees: FloatArray) -> str:
    runs = np.nanmean(nees, axis=1)
    error = runs.std(ddof=1) / np.sqrt(runs.size)
    inside = np.count_nonzero((runs >= 4.5) & (runs <= 7.5))
    covered = np.mean(nees[np.isfinite(nees)] <= NEES_95[6])
    return (
        f"NEES {runs.mean():.2f} +- {1.96 * error:.2f} (runs {runs.min():.1f} to {runs.max():.1f}, "
        f"{inside} from 4.5 to 7.5), {covered:.0%} within the 95 % bound"
    )


if __name__ == "__main__":
    main()
