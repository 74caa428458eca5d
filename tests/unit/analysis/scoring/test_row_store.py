"""Rows by the minute and numbers on disk: as if all were in memory."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from polars.testing import assert_frame_equal
from synthetic_log import Frame, SyntheticRun

from rpod_analysis import open_log, stream_run
from rpod_analysis.report.tables import joined_table, truth_table
from rpod_analysis.scoring import row_store
from rpod_analysis.scoring import run as run_module
from rpod_analysis.scoring.row_store import BLOCK_NS, Column, RowStore
from rpod_analysis.scoring.summarise import summarise
from rpod_analysis.scoring.totals import RunTotals

SHARES = (0.0, 0.25, 0.5, 0.95, 0.99, 1.0)


def test_rows_come_back_by_minute_and_stamp_in_whatever_order_they_came(monkeypatch):
    monkeypatch.setattr(row_store, "_MOST_PENDING", 100)
    stamps = np.random.default_rng(1).integers(0, 5 * BLOCK_NS, 1234).tolist()
    kept = RowStore()
    for number, stamp_ns in enumerate(stamps):
        kept.add((stamp_ns, number))
    assert (kept.count, kept.first_ns, kept.last_ns) == (1234, min(stamps), max(stamps))
    assert kept.minutes == [0, 1, 2, 3, 4]
    rows = [row for minute in kept.minutes for row in kept.rows(minute)]
    assert rows == sorted(zip(stamps, range(1234), strict=True))
    assert kept.rows(99) == []


def test_rows_that_come_after_a_minute_was_read_belong_to_it():
    kept = RowStore()
    kept.add((1, "a"))
    assert kept.rows(0) == [(1, "a")]
    kept.add((0, "b"))
    assert kept.rows(0) == [(0, "b"), (1, "a")]


@pytest.mark.parametrize("kind", ["normal", "heavy", "few values", "two clusters"])
def test_statistics_of_a_long_column_are_numpys(kind):
    random = np.random.default_rng(3)
    values = {
        "normal": random.normal(size=200_001),
        "heavy": random.standard_cauchy(150_000),
        "few values": random.integers(0, 3, 150_000).astype(float),
        "two clusters": np.concatenate([np.full(99_000, 1e-300), 1e9 + random.random(99_001)]),
    }[kind]
    column = Column()
    for part in np.array_split(values, 7):
        column.extend(np.append(part, np.nan))
    assert len(column) == values.size
    assert [column.quantile(share) for share in SHARES] == pytest.approx(
        np.quantile(values, SHARES).tolist(), rel=1e-12
    )
    assert column.mean == pytest.approx(values.mean(), rel=1e-9)
    assert column.rms == pytest.approx(np.sqrt((values**2).mean()))
    assert column.max == values.max()
    assert column.share_up_to(1.0) == (values <= 1.0).mean()
    edges = np.array([-np.inf, 0.0, 1.0, np.inf])
    assert column.counts(edges).sum() == values.size


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40), st.floats(0.0, 1.0))
def test_any_quantile_of_few_numbers_is_numpys(values, share):
    assert Column(np.array(values)).quantile(share) == pytest.approx(
        np.quantile(values, share), rel=1e-9, abs=1e-9
    )


@pytest.fixture(params=[0.5, 0.13], scope="module")
def cut(request, tmp_path_factory):
    """A run whose minutes are short, so that they cut between truth, estimates and statuses."""

    def frame(number, _time_s):
        shift = (0.01 * np.sin(number), 0.0, 0.4 if number == 11 else 0.0)
        return Frame(position_m=shift, covariance=np.eye(6) * 1e-4, nis=float(number))

    path = SyntheticRun(duration_s=2.0, rate_hz=11.3, frame=frame).write(
        tmp_path_factory.mktemp("cut") / "run.mcap"
    )
    with pytest.MonkeyPatch.context() as patch:
        for module in (row_store, run_module):
            patch.setattr(module, "BLOCK_NS", int(request.param * 1e9))
        with open_log(path) as log:
            yield log, stream_run(log)


def test_a_run_in_minutes_comes_to_what_the_whole_comes_to(cut):
    log, run = cut
    assert len(run.minutes) > 3
    in_minutes = summarise(log, run)
    assert in_minutes.estimates.unscored <= 1, "the last frame is behind the truth"
    whole = summarise(log, run, RunTotals.of(run.whole()))
    assert _equal(in_minutes, whole)


def _equal(mine, other):
    """Compare all numbers to 1e-12, everything else exactly."""
    if isinstance(mine, float) and isinstance(other, float):
        return mine == pytest.approx(other, rel=1e-12)
    if hasattr(mine, "model_dump"):
        return _equal(mine.model_dump(), other.model_dump())
    if isinstance(mine, dict):
        return mine.keys() == other.keys() and all(_equal(mine[key], other[key]) for key in mine)
    return mine == other


def test_tables_of_the_minutes_are_the_parts_of_the_wholes(cut):
    _, run = cut
    whole = run.whole()
    for table in (truth_table, joined_table):
        assert_frame_equal(pl.concat([table(minute) for minute in run]), table(whole), rel_tol=1e-12)


def test_one_long_reason_does_not_make_all_statuses_long(tmp_path):
    """An array of texts takes for each as much as for the longest: 260 kB for one of 65,000 characters."""
    run = SyntheticRun(frame=lambda number, _: Frame(reason="x" * 60_000 if number == 3 else ""))
    with open_log(run.write(tmp_path / "run.mcap")) as log:
        reasons = stream_run(log).whole().statuses.reason
    assert len(max(reasons, key=len)) == 501
    assert reasons.itemsize == 4 * 501
