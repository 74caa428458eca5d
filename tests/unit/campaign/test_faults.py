"""``faults``: a short LIDAR sequence through messages, a fault and the estimator; cells and summaries."""

import numpy as np
import polars as pl
import pytest

from rpod_campaign.engine.campaign import TRIAL, CellResult
from rpod_campaign.faults import trial
from rpod_campaign.faults.campaign import cells
from rpod_campaign.faults.options import Options
from rpod_campaign.faults.report import sections, summarise
from rpod_campaign.faults.trial import FRAME
from rpod_campaign.sequences.course import EPOCH_S, Shown
from rpod_pose.measurement import Measurement
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.messages import NANOSECONDS, read_points
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan, Mode


def options(**changes):
    return Options(sensor=("lidar",), **changes)


def test_cells_are_sizes_and_durations_of_the_faults_that_the_sensor_can_have():
    found = [
        (cell.fault, cell.size, cell.lasts_s)
        for cell in cells(options(fault=("glints", "saturation", "stop")))
    ]
    assert found == [
        ("glints", 0.2, 2.0),
        ("glints", 0.4, 2.0),
        ("glints", 0.8, 2.0),
        ("stop", None, 0.5),
        ("stop", None, 2.0),
    ]
    with pytest.raises(ConfigurationError, match="not 'disk_full'"):
        cells(options(fault=("disk_full",)))


def row(number, mode, accepted, error_deg):
    times = {"stamp_ns": number * 10**9, "begin_ns": 2 * 10**9, "end_ns": 4 * 10**9}
    errors = {"attitude_error_deg": error_deg, "position_error_m": None if error_deg is None else 0.01}
    return times | errors | {FRAME: number, "mode": int(mode), "accepted": accepted, "reason": ""}


def test_a_cell_sums_up_its_sequences_as_a_run_does_its_faults():
    (cell, *_) = cells(options(fault=("glints",)))
    rows = [
        row(1, Mode.TRACKING, True, 0.1),
        row(2, Mode.TRACKING, True, 20.0),
        row(3, Mode.LOST, False, None),
        row(4, Mode.VERIFYING, False, None),
        row(5, Mode.TRACKING, True, 30.0),
    ]
    table = pl.DataFrame(rows, schema=trial.SCHEMA).with_columns(pl.lit(0).alias(TRIAL))
    summary = summarise(cell, table)
    assert (summary["tracking_share"], summary["lost"], summary["lost_after_s"]) == (0.5, 1, 1.0)
    assert (summary["back"], summary["tracking_again_s"]) == (1, 1.0)
    assert (summary["wrong_accepted"], summary["worst_deg"]) == (1, 20.0)
    (section,) = sections([CellResult(cell, table, summary)])
    assert len(section.tables[0].rows) == 1


def shown(time_s):
    points_m = np.tile(np.float32((0.0, 0.0, 20.0)), (50, 1))
    scan = LidarScan(
        stamp_ns=round((EPOCH_S + time_s) * NANOSECONDS),
        frame_id="lidar",
        points_m=points_m,
        intensity=np.ones(50, np.float32),
        time_s=None,
    )
    return Shown(time_s, Measurement("lidar", scan, make_pose()))


def test_a_sensor_announces_itself_and_its_frames_pass_through_the_fault(monkeypatch):
    monkeypatch.setattr(trial, "lidar_of", lambda *_: LidarConfig())
    cell = cells(options(fault=("glints",)))[-1]
    sensor = trial._Sensor(cell, 0, shown(0.0))
    assert {message.topic.name for message in sensor.announcement()} == {"tf_static", "lidar/info"}
    (before,) = sensor.messages(shown(0.0))
    *again, during = sensor.messages(shown(cell.start_s))
    assert {message.topic.name for message in again} == {"tf_static", "lidar/info"}, "they may have changed"
    assert np.all(read_points(before.decode())["z"] == 20.0)
    assert not np.all(read_points(during.decode())["z"] == 20.0)
    assert during.attachment.sequence == before.attachment.sequence + 1
