"""Rows and columns of a scan without a return are named where others beside them have some."""

import numpy as np
import pytest

from rpod_runtime.sensor_data.empty_lines import EmptyLines


def scan(rows=12, columns=20, dead=(), away=np.nan):
    points_m = np.full((rows, columns, 3), 5.0, np.float32)
    points_m[:2] = points_m[-2:] = points_m[:, :3] = points_m[:, -3:] = away  # beside the target
    points_m[list(dead)] = away
    return points_m


def lines_after(scans):
    lines = EmptyLines()
    for points_m in scans:
        lines.add(points_m)
    return lines


@pytest.mark.parametrize("away", [np.nan, 0.0, np.inf])
def test_dead_rows_between_others_are_named_and_what_lies_beside_the_target_is_not(away):
    lines = lines_after([scan(dead=(4, 7, 8), away=away)] * 3)
    assert (lines.rows(), lines.columns()) == ([4, 7, 8], [])
    assert "3 rows had no return in 3 scans" in lines.text
    assert "write dead_rows: [4, 7, 8] for the sensor" in lines.text


def test_dead_columns_are_named_too():
    lines = lines_after([scan(20, 12, dead=(5,)).transpose(1, 0, 2)] * 3)
    assert (lines.rows(), lines.columns()) == ([], [5])
    assert lines.text.startswith("1 column had no return in 3 scans, between columns that had")


@pytest.mark.parametrize(
    "scans",
    [
        [],
        [scan(dead=(4,))] * 2,
        [scan()] * 5,
        [scan(dead=(4,))] * 4 + [scan()],
        [scan(dead=(4,))] * 2 + [scan(14, dead=(4,))] * 2,
        [scan(dead=range(2, 9))] * 5,
    ],
    ids=["none", "too few", "no empty row", "a row with a return at last", "another size", "only one side"],
)
def test_nothing_is_named_where_nothing_is_known(scans):
    assert lines_after(scans).text == ""
