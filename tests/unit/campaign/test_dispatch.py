"""Batches given to workers over a connection that a test decides on."""

import time
from collections.abc import Callable
from typing import Any

import pytest
from counting_campaign import CAMPAIGN, CountingOptions

from rpod_campaign.engine.errors import WorkerDiedError
from rpod_campaign.engine.executor import cluster_worker, dispatch
from rpod_campaign.engine.executor.batches import Batches
from rpod_campaign.engine.executor.cluster import _job
from rpod_campaign.engine.executor.cluster_worker import Answer, Delivery
from rpod_campaign.engine.executor.dispatch import Dispatch, SchedulerLostError
from rpod_campaign.engine.run import prepare

ADDRESS = "tcp://127.0.0.1:1"


class PlayedFuture:
    """A future that is pending until the test ends it."""

    def __init__(self, name: str, arguments: tuple[Any, ...]) -> None:
        self.name, self.arguments, self.status = name, arguments, "pending"
        self._called: list[Callable[[Any], None]] = []
        self.before_result: Callable[[], None] = lambda: None

    def add_done_callback(self, function: Callable[[Any], None]) -> None:
        self._called.append(function)

    def end(self, status: str = "finished") -> None:
        self.status = status
        for function in self._called:
            function(self)

    def result(self, timeout: float) -> Answer | Delivery:  # noqa: ARG002 - as Dask's
        self.before_result()
        return Answer("", ()) if self.name == "hello" else Delivery(self.arguments[2], b"", 0.01, None)

    def cancel(self) -> None:
        self.end("cancelled")


class PlayedClient:
    """A scheduler with workers that answer at once, if the test does not take their futures first."""

    def __init__(self, *workers: str) -> None:
        self.status, self.scheduler, self.workers = "running", self, workers
        self.runs: list[tuple[str, PlayedFuture]] = []
        self.take: Callable[[str, PlayedFuture], bool] = lambda *_: False

    def identity(self, n_workers: int) -> dict[str, Any]:
        assert n_workers == -1
        return {"id": "one", "workers": {name: {"name": name} for name in self.workers}}

    def sync(self, function: Callable[..., Any], **options: Any) -> Any:
        assert options.pop("callback_timeout") > 0.0
        return function(**options)

    def submit(self, function: Any, *arguments: Any, workers: list[str], **_: Any) -> PlayedFuture:
        future = PlayedFuture("hello" if function is cluster_worker.check_worker else "run", arguments)
        if future.name == "run":
            self.runs.append((workers[0], future))
        if not self.take(workers[0], future):
            future.end()
        return future


@pytest.fixture
def supply(tmp_path, monkeypatch, request):
    """Return a function that makes the dispatch of trials to a client's workers, and what it notes.

    There are two cells of ten trials, or of as many as the test says.
    """
    monkeypatch.setattr(dispatch, "_LOOK_S", 0.01)
    trials = getattr(request, "param", 10)
    work = prepare(CAMPAIGN, CountingOptions(trials=trials), out=tmp_path, version="1")
    batches, notes = Batches(work.tasks()), []

    def make(client: PlayedClient) -> Dispatch:
        return Dispatch(client, work.work, _job(work.work), batches, note=notes.append)

    return make, batches, notes


def finished(run) -> list[tuple[int, int]]:
    return [(arrived.batch[0].cell, trial) for arrived in run for trial in arrived.new]


ALL = {(cell, trial) for cell in range(2) for trial in range(10)}


def test_a_connection_that_is_lost_between_two_batches_loses_no_trial(supply):
    make, batches, _ = supply
    client, held = PlayedClient("a"), []
    client.take = lambda _, future: future.name == "run" and not held.append(future)

    def lost() -> None:  # while the first answer is fetched
        client.status = "connecting"
        held[1].end("cancelled")

    run, before = make(client).run(ADDRESS, patience_s=60.0), []

    def end_both() -> None:
        held[0].before_result = lost
        held[0].end()

    real = dispatch.Dispatch._feed

    def feed(self) -> None:
        real(self)
        if len(held) == 2 and held[0].status == "pending":
            end_both()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dispatch.Dispatch, "_feed", feed)
        with pytest.raises(SchedulerLostError):
            before += [(one.batch[0].cell, trial) for one in run for trial in one.new]
    assert len(held) == 2
    assert batches.left == 19
    client = PlayedClient("a")
    after = finished(make(client).run(ADDRESS, patience_s=60.0))
    assert len(after) == 19
    assert {*after, (0, 0)} == ALL


def test_trials_that_never_come_back_are_told_and_run_by_others(supply):
    make, _, notes = supply
    client = PlayedClient("a", "b")
    client.take = lambda address, _: address == "b" and len(client.runs) > 1
    assert set(finished(make(client).run(ADDRESS, patience_s=0.2))) == ALL
    assert len([note for note in notes if "worker b at b: no trial came back for" in note]) == 1


def test_a_lone_worker_that_answers_after_its_trials_were_lost_runs_them_again(supply):
    make, _, notes = supply
    client = PlayedClient("a")
    client.take = lambda _, future: future.name == "run" and len(client.runs) in (3, 4)
    assert sorted(finished(make(client).run(ADDRESS, patience_s=0.2))) == sorted(ALL)
    assert len(notes) == 1


def test_a_lone_worker_with_a_long_trial_is_waited_for_and_told_of_twice(supply):
    make, _, notes = supply
    client, held = PlayedClient("a"), []
    begin_s = time.monotonic()

    def take(_: str, future: PlayedFuture) -> bool:
        if held and len(notes) < 2:  # the question waits behind the trial
            return True
        return future.name == "run" and not held and not held.append(future)

    client.take = take
    dispatched = make(client)
    real = dispatched._note

    def note(text: str) -> None:
        real(text)
        if len(notes) == 2:
            held[0].end()

    dispatched._note = note
    run = dispatched.run(ADDRESS, patience_s=0.2)
    first = next(run)
    run.close()
    assert first.new == (0,)
    assert len(notes) == 2
    assert time.monotonic() - begin_s > 0.4


@pytest.mark.parametrize("supply", [1, 2, 10], indirect=True)
def test_a_trial_that_ends_its_worker_with_the_answer_of_the_one_before_is_the_one_that_is_named(supply):
    make, _, _ = supply
    client, held = PlayedClient("worker-0"), []
    client.take = lambda _, future: future.name == "run" and not held.append(future)
    real = dispatch.Dispatch._feed

    def feed(self) -> None:
        real(self)
        if any(future.arguments[1:] == (1, (0,)) for future in held):
            client.workers = (f"worker-{len(client.runs)}",)  # in place of the one that ended
        else:
            for future in held:
                future.end()
        held.clear()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dispatch.Dispatch, "_feed", feed)
        with pytest.raises(WorkerDiedError, match=r"ended 3 times .*cell 1 .*trial 0"):
            finished(make(client).run(ADDRESS, patience_s=60.0))
