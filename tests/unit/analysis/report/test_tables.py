"""A run as tables and as trajectories."""

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from synthetic_log import EPOCH_NS, T_CHASER_SENSOR, Frame, SyntheticRun, approach

from rpod_analysis import open_log, read_run
from rpod_analysis.report.tables import (
    estimate_table,
    joined_table,
    status_table,
    truth_table,
    write_tables,
)
from rpod_schemas.types import Mode

COVARIANCE = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e-4


def frame(number, _time_s):
    if number < 3:
        return Frame(mode=Mode.ACQUIRING, reason="nothing found")
    return Frame(position_m=(0.0, 0.02, 0.0), attitude_rad=(0.01, 0.0, 0.0), covariance=COVARIANCE)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("tables") / "run.mcap"
    with open_log(SyntheticRun(frame=frame, truth_gaps_s=((1.4, 1.6),)).write(path)) as log:
        return read_run(log)


def test_truth_and_estimates_have_a_row_each_with_units_in_the_columns(run):
    truth, estimates = truth_table(run), estimate_table(run)
    assert truth.columns == ["stamp_ns", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    assert len(truth) == len(run.truth)
    np.testing.assert_array_equal(estimates["covariance"].to_numpy()[0].reshape(6, 6), COVARIANCE)
    assert estimates["latency_s"].to_list() == pytest.approx([0.06] * 18)


def test_a_status_row_says_what_became_of_a_frame(run):
    statuses = status_table(run)
    assert statuses["mode"].to_list() == ["ACQUIRING"] * 3 + ["TRACKING"] * 18
    assert statuses.filter(~pl.col("accepted"))["reason"].unique().to_list() == ["nothing found"]


def test_status_estimate_truth_and_errors_are_joined_on_the_stamp(run):
    joined = joined_table(run)
    assert joined["stamp_ns"].to_list() == [EPOCH_NS + k * 100_000_000 for k in range(21)]
    assert joined["x_m"].null_count() == 3, "frames without an estimate"
    assert joined["truth_x_m"].null_count() == 4, "and one without truth"
    scored = joined.drop_nulls("nees")
    np.testing.assert_allclose(scored["y_error_m"], 0.02, atol=1e-9)
    np.testing.assert_allclose(scored["roll_error_deg"], np.rad2deg(0.01), atol=1e-9)
    offset = scored.select(
        pl.col("x_m") - pl.col("truth_x_m"), pl.col("y_m") - pl.col("truth_y_m")
    ).to_numpy()
    np.testing.assert_allclose(offset[0], (T_CHASER_SENSOR.rotation.apply([0.0, 0.02, 0.0]))[:2], atol=1e-9)


def test_a_table_is_arrow_for_whoever_asks(run):
    assert hasattr(joined_table(run), "__arrow_c_stream__")


def test_parquet_tables_come_back_as_they_were(run, tmp_path):
    write_tables(tmp_path, [run])
    assert pl.read_parquet(tmp_path / "frames.parquet").equals(joined_table(run))
    assert pl.read_parquet(tmp_path / "truth.parquet").equals(truth_table(run))


def test_trajectories_are_lines_of_the_tum_format(run, tmp_path):
    write_tables(tmp_path, [run])
    lines = (tmp_path / "truth.tum").read_text("utf-8").splitlines()
    assert len(lines) == len(run.truth)
    index = int(np.flatnonzero(run.truth.stamp_ns == EPOCH_NS)[0])
    stamp, *numbers = lines[index].split()
    assert stamp == f"{EPOCH_NS // 10**9}.000000000"
    values = np.array(numbers, float)
    pose = RigidTransform.from_components(values[:3], Rotation.from_quat(values[3:]))
    expected = T_CHASER_SENSOR * approach(0.0)
    np.testing.assert_allclose(pose.as_matrix(), expected.as_matrix(), atol=1e-8)


def test_a_run_without_truth_or_estimates_has_tables_too(tmp_path):
    silent = SyntheticRun(with_truth=False, frame=lambda *_: Frame(mode=Mode.ACQUIRING, reason="nothing"))
    with open_log(silent.write(tmp_path / "run.mcap")) as log:
        run = read_run(log)
    write_tables(tmp_path, [run])
    assert len(joined_table(run)) == 21
    assert (tmp_path / "estimate.tum").read_text("utf-8") == ""
