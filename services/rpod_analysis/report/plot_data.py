"""Data of a run's figures in bounded memory, as downsampled lines that keep all peaks."""

import numpy as np

from rpod_analysis.report.downsampling import Band, Line, Samples
from rpod_analysis.scoring.run import Run, StreamedRun
from rpod_analysis.scoring.score import IntArray
from rpod_schemas.arrays import FloatArray
from rpod_schemas.faults.injected import InjectedFault

_MOST_TICKS = 2000
_MOST_STEPS = 1200
_MOST_FRAMES = 200


class PlotData:
    """Collects the data of the figures, minute by minute."""

    def __init__(
        self,
        start_ns: int,
        end_ns: int,
        sensors: tuple[str, ...] = (),
        faults: tuple[InjectedFault, ...] = (),
    ) -> None:
        self.start_ns, self.end_ns = start_ns, end_ns
        self.faults = faults
        """Faults that were injected."""
        span_ns = start_ns, end_ns
        self.angle_deg, self.distance_m = Line(span_ns), Line(span_ns)
        """Magnitudes of the errors."""
        self.attitude_deg = tuple(Line(span_ns) for _ in range(3))
        """Errors in roll, pitch and yaw, target axes."""
        self.position_m = tuple(Line(span_ns) for _ in range(3))
        """Errors in x, y and z, axes of the sensor."""
        self.sigma_deg = tuple(Line(span_ns) for _ in range(3))
        self.sigma_m = tuple(Line(span_ns) for _ in range(3))
        self.nees, self.nis = Line(span_ns), Line(span_ns)
        self.true_range_m, self.range_m = Line(span_ns), Line(span_ns)
        """True and estimated distance of the target."""
        self.mode, self.source = Band(), Band()
        self.rejected = Samples(span_ns, _MOST_TICKS)
        self.reasons: list[str] = []
        """Reasons of the drawn rejected frames."""
        self.true_path, self.path = Samples(span_ns, _MOST_STEPS, 3), Samples(span_ns, _MOST_STEPS, 3)
        """Positions of the target, chaser axes, m."""
        self.frames = {sensor: Samples(span_ns, _MOST_FRAMES) for sensor in sensors}
        """Stamps of the frames of each sensor that have an estimate."""
        self.any_frames = {sensor: Samples(span_ns, _MOST_FRAMES) for sensor in sensors}

    @classmethod
    def of(cls, run: StreamedRun) -> "PlotData":
        """Return the data of a run's figures."""
        plot_data = cls(run.start_ns, run.end_ns, tuple(run.sensors), run.faults)
        for minute in run:
            plot_data.take(minute)
        return plot_data

    def seconds(self, stamp_ns: IntArray) -> FloatArray:
        """Return stamps, ns of UTC, as seconds from the start of the run, in the same shape."""
        return (stamp_ns - self.start_ns) * np.float64(1e-9)

    def take(self, run: Run) -> None:
        """Add a minute of the run."""
        self._take_errors(run)
        self._take_statuses(run)
        for track, line, path in (
            (run.truth, self.true_range_m, self.true_path),
            (run.estimates, self.range_m, self.path),
        ):
            line.extend(track.stamp_ns, np.linalg.norm(track.poses.translation.reshape(-1, 3), axis=1))
            path.extend(track.stamp_ns, track.poses.translation.reshape(-1, 3))
        for sensor, frames in run.frames.items():
            estimated = np.isin(frames.stamp_ns, run.estimates.stamp_ns)
            for samples, stamp_ns in (
                (self.frames[sensor], frames.stamp_ns[estimated]),
                (self.any_frames[sensor], frames.stamp_ns),
            ):
                samples.extend(stamp_ns, np.empty((stamp_ns.size, 0)))

    def _take_errors(self, run: Run) -> None:
        errors, stamp_ns = run.errors, run.estimates.stamp_ns
        attitude_deg, position_m = np.rad2deg(errors.attitude_rad), errors.position_m
        self.angle_deg.extend(stamp_ns, np.rad2deg(errors.angle_rad))
        self.distance_m.extend(stamp_ns, errors.distance_m)
        sigma_deg, sigma_m = _sigmas(run)
        for axis in range(3):
            self.attitude_deg[axis].extend(stamp_ns, attitude_deg[:, axis])
            self.position_m[axis].extend(stamp_ns, position_m[:, axis])
            self.sigma_deg[axis].extend(stamp_ns, sigma_deg[:, axis])
            self.sigma_m[axis].extend(stamp_ns, sigma_m[:, axis])
        self.nees.extend(stamp_ns[run.tracked], errors.nees[run.tracked])

    def _take_statuses(self, run: Run) -> None:
        statuses = run.statuses
        order, newest_ns = statuses.by_arrival()
        self.mode.extend(newest_ns, statuses.mode[order])
        self.source.extend(statuses.stamp_ns, statuses.source)
        self.nis.extend(statuses.stamp_ns, statuses.nis)
        rejected = ~statuses.accepted
        stamp_ns = statuses.stamp_ns[rejected]
        kept = self.rejected.extend(stamp_ns, np.empty((stamp_ns.size, 0)))
        self.reasons += statuses.reason[rejected][kept].tolist()


def _sigmas(run: Run) -> tuple[FloatArray, FloatArray]:
    """Return sigma of attitude in target axes, deg, and of position in the sensor's, m, each (N, 3)."""
    R = run.estimates.poses.rotation.as_matrix()
    attitude = np.einsum("nji,njk,nki->ni", R, run.covariance[:, 3:, 3:], R)
    C = run.R_chaser_sensor.as_matrix()
    position = np.einsum("nji,njk,nki->ni", C, run.covariance[:, :3, :3], C)
    return np.rad2deg(np.sqrt(attitude.clip(0.0))), np.sqrt(position.clip(0.0))
