import multiprocessing
import os

import polars as pl
import pytest
from counting_campaign import CAMPAIGN, CountingOptions

from rpod_campaign.engine import Options
from rpod_campaign.engine.errors import ForeignFolderError, TrialFailedError, WorkerDiedError
from rpod_campaign.engine.executor.pool import ProcessPool
from rpod_campaign.engine.report.charts import distinct
from rpod_campaign.engine.report.content import Table
from rpod_campaign.engine.report.numbers import NONE
from rpod_campaign.engine.report.page import write_page
from rpod_campaign.engine.report.statistics import mean, quantile, rate
from rpod_campaign.engine.run import Prepared, prepare, results
from rpod_campaign.engine.run import run_campaign as run_with
from rpod_schemas.errors import ConfigurationError

INTERRUPTED_AFTER = 4


def prepared(out, **options) -> Prepared:
    return prepare(CAMPAIGN, CountingOptions(**options), out=out, version="1")


def run_campaign(campaign: Prepared, *, jobs: int, on_trial=lambda _: None) -> list:
    return run_with(campaign, ProcessPool(jobs), on_trial=on_trial)


def rows_of(results) -> pl.DataFrame:
    return pl.concat([result.rows for result in results])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the results of a campaign that nobody disturbed."""
    return run_campaign(prepared(tmp_path_factory.mktemp("whole"), trials=6), jobs=2)


def test_every_cell_has_all_of_its_trials_in_their_order(whole):
    assert [result.summary["factor"] for result in whole] == [1.0, 2.0]
    for result in whole:
        assert result.rows["trial"].to_list() == list(range(6))


def test_one_trial_of_each_cell_is_run_before_the_others(tmp_path):
    tasks = [tuple(task) for task in prepared(tmp_path, trials=3).tasks()]
    assert tasks == [(0, 0), (1, 0), (0, 1), (0, 2), (1, 1), (1, 2)]


def test_a_complete_campaign_runs_nothing_again_and_more_trials_add_to_it(tmp_path, whole):
    run_campaign(prepared(tmp_path, trials=4), jobs=1)
    again = prepared(tmp_path, trials=4)
    assert list(again.tasks()) == []
    told = []
    assert rows_of(run_campaign(again, jobs=1, on_trial=told.append)).height == 8
    assert not told
    more = prepared(tmp_path, trials=6)
    assert {task.trial for task in more.tasks()} == {4, 5}
    assert rows_of(run_campaign(more, jobs=1)).equals(rows_of(whole))
    fewer = prepared(tmp_path, trials=2)
    assert rows_of(results(fewer, fewer.folder.read())).height == 4


def test_an_interrupted_campaign_keeps_what_is_done_and_ends_as_if_it_had_not_been(tmp_path, whole):
    def interrupt(_):
        told.append(_)
        if len(told) == INTERRUPTED_AFTER:
            raise KeyboardInterrupt

    told: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        run_campaign(prepared(tmp_path, trials=6), jobs=1, on_trial=interrupt)
    assert not multiprocessing.active_children()
    resumed = prepared(tmp_path, trials=6)
    assert len(resumed.done) == INTERRUPTED_AFTER
    assert rows_of(run_campaign(resumed, jobs=1)).equals(rows_of(whole))
    assert [file.name for file in sorted(resumed.folder.path.iterdir())] == [
        "manifest.json",
        "trials.parquet",
    ]


def test_a_trial_that_raises_is_told_as_what_it_is_with_its_seed_and_the_others_are_kept(tmp_path):
    with pytest.raises(TrialFailedError, match="trial 0, seed 1: ArithmeticError: unlucky") as caught:
        run_campaign(prepared(tmp_path, ranges=(1.0, 13.0), trials=3), jobs=1)
    assert isinstance(caught.value.__cause__, ArithmeticError)
    assert "counting_campaign.py" in caught.value.trace
    assert not caught.value.expected
    assert set(prepared(tmp_path, ranges=(1.0, 13.0), trials=3).done) == {(0, 0)}


def test_an_exception_that_cannot_be_pickled_is_no_want_of_memory(tmp_path):
    with pytest.raises(TrialFailedError, match="TwoPartsError: mesh: has no triangles") as caught:
        run_campaign(prepared(tmp_path, ranges=(14.0,), trials=1), jobs=1)
    assert caught.value.__cause__ is None


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (99.0, "was killed by SIGKILL, by the kernel if memory ran out: try fewer --jobs"),
        (98.0, "crashed by SIGSEGV, a fault in compiled code"),
        (97.0, "ended with exit code 3"),
    ],
)
def test_a_process_that_ends_is_told_by_how_it_ended_and_the_others_are_kept(tmp_path, factor, says):
    with pytest.raises(WorkerDiedError, match=rf"{says} while it ran one of: counting, cell 1 .* trial 0"):
        run_campaign(prepared(tmp_path, ranges=(1.0, factor), trials=2), jobs=1)
    assert set(prepared(tmp_path, ranges=(1.0, factor), trials=2).done) == {(0, 0)}


def test_what_a_killed_process_has_left_is_removed_and_what_is_being_written_is_not(tmp_path):
    folder = prepared(tmp_path, trials=2).folder.path
    old, new = folder / "part-a.1.tmp", folder / "part-b.2.tmp"
    for file in (old, new):
        file.write_bytes(b"half")
    os.utime(old, (0, 0))
    run_campaign(prepared(tmp_path, trials=2), jobs=1)
    assert not old.exists()
    assert new.exists()


def test_a_changed_parameter_is_another_folder(tmp_path):
    paths = {
        prepared(tmp_path, **options).folder.path
        for options in ({}, {"seed": 2}, {"ranges": (1.0,)}, {"ranges": (1.0, 3.0)})
    }
    assert len(paths) == 4
    assert prepared(tmp_path, trials=9).folder.path in paths
    newer = prepare(CAMPAIGN, CountingOptions(), out=tmp_path, version="2").folder
    assert newer.path not in paths
    assert newer.most_alike() == (prepared(tmp_path).folder.path, ("version",))


@pytest.mark.parametrize("damaged", [b"", b'{"campaign": "coun', b"\xff\xfe", b"[]"])
def test_a_damaged_manifest_of_another_folder_is_passed_over(tmp_path, damaged):
    (prepared(tmp_path, seed=2).folder.path / "manifest.json").write_bytes(damaged)
    mine = prepared(tmp_path).folder
    assert mine.most_alike() is None
    other = prepared(tmp_path, seed=3).folder
    assert mine.most_alike() == (other.path, ("seed",))


def test_a_manifest_outlives_a_loss_of_power(tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(os, "fsync", kept.append)
    prepared(tmp_path)
    assert len(kept) == 1


def test_a_folder_of_something_else_is_refused(tmp_path):
    manifest = prepared(tmp_path).folder.path / "manifest.json"
    manifest.write_text("{}")
    with pytest.raises(ForeignFolderError, match="of another campaign; give another --out"):
        prepared(tmp_path)
    manifest.rename(manifest.with_name("other.json"))
    with pytest.raises(ForeignFolderError, match=r"has no manifest\.json"):
        prepared(tmp_path)


def test_the_processes_of_the_trials_have_one_thread_and_this_one_keeps_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("POLARS_MAX_THREADS", raising=False)
    seen = []

    def look(_):
        seen.append(os.environ["OMP_NUM_THREADS"])

    run_campaign(prepared(tmp_path, trials=1), jobs=1, on_trial=look)
    assert set(seen) == {"1"}
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert "POLARS_MAX_THREADS" not in os.environ


def test_options_of_another_campaign_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"counting: needs counting_campaign"):
        prepare(CAMPAIGN, Options(), out=tmp_path, version="1")


def test_the_page_needs_no_network(tmp_path):
    campaign = prepared(tmp_path, trials=1)
    page = write_page(campaign, CAMPAIGN.sections([]), version="1", machine={"processes": "2"})
    text = page.read_text("utf-8")
    assert "0 cells" in text
    assert "<script src" not in text
    assert "<link" not in text


def test_a_rate_has_its_wilson_interval():
    share = rate(8, 10)
    assert (share.value, share.low, share.high) == pytest.approx((0.8, 0.4901625, 0.9433178), abs=1e-7)
    assert str(share) == "0.800 [0.490, 0.943]"
    assert rate(10, 10).high == 1.0
    assert str(rate(0, 0)) == "-"


def test_numbers_of_nothing_are_none():
    nothing = pl.Series([None, float("nan")], dtype=pl.Float64)
    assert mean(nothing) is None
    assert quantile(nothing, 0.5) is None
    assert quantile(pl.Series([1.0, None, 3.0]), 0.5) == 2.0


def test_names_that_all_rows_share_go_into_the_title_of_a_table():
    table = Table(
        "Success",
        ("target", "step, deg", "range, m", "rate"),
        (("a", "30", "20", "1"), ("a", "30", "50", "1")),
    )
    condensed = table.condensed(3)
    assert condensed == Table(
        "Success (target a, step 30 deg)", ("range, m", "rate"), (("20", "1"), ("50", "1"))
    )


def test_a_line_of_a_figure_is_named_by_what_differs():
    names = [("a", "30 deg", NONE), ("a", "10 deg", "25 px")]
    assert [distinct(name, names) for name in names] == ["30 deg", "10 deg, 25 px"]
    assert not distinct(names[0], names[:1])


def test_a_column_without_any_value_is_left_out_of_a_table():
    columns = ("range, m", "paper", "ICP, ms", "rate")
    rows = (("20", "", NONE, "1"), ("50", "0.9", NONE, "1"))
    assert Table("", columns, rows).condensed(1).columns == ("range, m", "paper", "rate")
    assert Table("", columns, rows[:1]).condensed(0).columns == ("range, m", "rate")
    assert Table("", columns, ()).condensed(1).columns == columns
