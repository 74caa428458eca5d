"""Tables of a run, for polars and programs that read Arrow: truth, estimates, statuses, and all by stamp.

A polars frame passes its columns to pyarrow, pandas or DuckDB without copying (``__arrow_c_stream__``). The
names of the columns contain their units; stamps are nanoseconds of UTC.
"""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import polars as pl
from polars.io.plugins import register_io_source
from scipy.spatial.transform import RigidTransform

from rpod_analysis.scoring.run import Run
from rpod_analysis.scoring.score import Track
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Mode, Source

_ROW_GROUP = 1 << 15
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def truth_table(run: Run) -> pl.DataFrame:
    """Return the true poses T_chaser_target: stamp_ns, x_m, y_m, z_m, qx, qy, qz, qw."""
    return _track_table(run.truth)


def estimate_table(run: Run) -> pl.DataFrame:
    """Return the estimated poses T_chaser_target with ``covariance``, 36 numbers by rows (ICD section 1)."""
    covariance = pl.Series("covariance", run.covariance.reshape(-1, 36), dtype=pl.Array(pl.Float64, 36))
    return _track_table(run.estimates).with_columns(covariance, pl.Series("latency_s", run.latency_s))


def status_table(run: Run) -> pl.DataFrame:
    """Return for each frame: sensor, mode, source, accepted, reason, nis, processing_s."""
    statuses = run.statuses
    return pl.DataFrame(
        {
            "stamp_ns": statuses.stamp_ns,
            "sensor": statuses.sensor.tolist(),
            "mode": [Mode(mode).name for mode in statuses.mode],
            "source": [Source(source).name for source in statuses.source],
            "accepted": statuses.accepted,
            "reason": statuses.reason.tolist(),
            "nis": statuses.nis,
            "processing_s": statuses.processing_s,
        },
        schema_overrides=dict.fromkeys(("sensor", "mode", "source", "reason"), pl.String),
    )


def joined_table(run: Run) -> pl.DataFrame:
    """Return a row for each frame: its status, the estimate of the same stamp, the truth, and the errors.

    The truth is interpolated at the estimate's stamp; unknown values are null. Errors are defined as in the
    ICD: attitude in target axes, position in the sensor's axes.
    """
    known = run.errors.scored
    truth = _pose_columns(run.T_truth, prefix="truth_")
    roll, pitch, yaw = np.rad2deg(run.errors.attitude_rad).T
    x_m, y_m, z_m = run.errors.position_m.T
    scored = truth | {
        "roll_error_deg": roll,
        "pitch_error_deg": pitch,
        "yaw_error_deg": yaw,
        "x_error_m": x_m,
        "y_error_m": y_m,
        "z_error_m": z_m,
        "nees": run.errors.nees,
    }
    columns = [
        pl.Series(name, np.where(known, values, np.nan)).fill_nan(None) for name, values in scored.items()
    ]
    estimates = estimate_table(run).with_columns(columns).unique("stamp_ns", keep="last", maintain_order=True)
    return status_table(run).join(estimates, on="stamp_ns", how="full", coalesce=True).sort("stamp_ns")


def write_tables(directory: Path, run: Iterable[Run]) -> None:
    """Write ``truth.parquet``, ``frames.parquet`` and, for evo, ``truth.tum`` and ``estimate.tum``.

    Args:
        directory: folder to write to.
        run: minutes of a run in their order; it is iterated once for each table.
    """
    _write_parquet(directory / "truth.parquet", run, truth_table)
    _write_parquet(directory / "frames.parquet", run, joined_table)
    with (directory / "truth.tum").open("w") as truth, (directory / "estimate.tum").open("w") as estimate:
        for minute in run:
            truth.writelines(tum_lines(minute.truth))
            estimate.writelines(tum_lines(minute.estimates))


def _write_parquet(path: Path, run: Iterable[Run], table: Callable[[Run], pl.DataFrame]) -> None:
    """Write a table in row groups, minute by minute."""

    def rows(*_: object) -> Iterator[pl.DataFrame]:
        return (table(minute) for minute in run)

    register_io_source(rows, schema=next(rows()).schema).sink_parquet(path, row_group_size=_ROW_GROUP)


def tum_lines(track: Track) -> Iterator[str]:
    """Yield poses in the TUM RGB-D format, which evo reads: lines of seconds, x, y, z, qx, qy, qz, qw."""
    rows = np.column_stack(list(_pose_columns(track.poses).values()))
    for stamp, row in zip(track.stamp_ns.tolist(), rows.tolist(), strict=True):
        yield f"{stamp // 10**9}.{stamp % 10**9:09d} {' '.join(f'{value:.9g}' for value in row)}\n"


def _track_table(track: Track) -> pl.DataFrame:
    return pl.DataFrame({"stamp_ns": track.stamp_ns} | _pose_columns(track.poses))


def _pose_columns(poses: RigidTransform, prefix: str = "") -> dict[str, FloatArray]:
    numbers = np.hstack([poses.translation, poses.rotation.as_quat()]).reshape(-1, 7)
    return {
        f"{prefix}{name}": np.ascontiguousarray(column) for name, column in zip(_POSE, numbers.T, strict=True)
    }
