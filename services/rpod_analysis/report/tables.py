"""Tables of a run, for polars and whatever reads Arrow: truth, estimates, statuses, and all by stamp.

A polars frame hands its columns to pyarrow, pandas or DuckDB without copying (``__arrow_c_stream__``). They
carry their units in their names; stamps are nanoseconds of UTC.
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
    """Return of each frame: sensor, mode, source, accepted, reason, nis, processing_s."""
    said = run.statuses
    return pl.DataFrame(
        {
            "stamp_ns": said.stamp_ns,
            "sensor": said.sensor.tolist(),
            "mode": [Mode(mode).name for mode in said.mode],
            "source": [Source(source).name for source in said.source],
            "accepted": said.accepted,
            "reason": said.reason.tolist(),
            "nis": said.nis,
            "processing_s": said.processing_s,
        },
        schema_overrides=dict.fromkeys(("sensor", "mode", "source", "reason"), pl.String),
    )


def joined_table(run: Run) -> pl.DataFrame:
    """Return a row for each frame: its status, the estimate of the same stamp, the truth, and the errors.

    Truth is interpolated at the estimate's stamp; where it is not known, columns are null. Errors
    are those of the ICD: attitude in target axes, position in the sensor's.
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
        directory: where to.
        run: minutes of a run in their order, gone through once for each table; rows are written as they come.
    """
    _write_parquet(directory / "truth.parquet", run, truth_table)
    _write_parquet(directory / "frames.parquet", run, joined_table)
    with (directory / "truth.tum").open("w") as truth, (directory / "estimate.tum").open("w") as estimate:
        for minute in run:
            truth.writelines(tum_lines(minute.truth))
            estimate.writelines(tum_lines(minute.estimates))


def _write_parquet(path: Path, run: Iterable[Run], table: Callable[[Run], pl.DataFrame]) -> None:
    """Write a table in row groups, as the minutes come."""

    def rows(*_: object) -> Iterator[pl.DataFrame]:
        return (table(minute) for minute in run)

    register_io_source(rows, schema=next(rows()).schema).sink_parquet(path, row_group_size=_ROW_GROUP)


def tum_lines(track: Track) -> Iterator[str]:
    """Return poses as evo reads them: a line of seconds, x, y, z, qx, qy, qz, qw each (TUM RGB-D format)."""
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
