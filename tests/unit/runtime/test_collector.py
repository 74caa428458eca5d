"""The garbage collector of a process that starts."""

import gc

import pytest

from rpod_runtime.process.collector import process_has_started, process_starts
from rpod_runtime.process.notify import ServiceManager


@pytest.fixture(autouse=True)
def _as_before():
    usual = gc.get_threshold()
    yield
    process_has_started()
    gc.unfreeze()
    assert gc.get_threshold() == usual


def test_a_service_that_is_ready_collects_as_usual_without_what_was_made_before():
    usual = gc.get_threshold()
    process_starts()
    process_starts()
    assert gc.get_threshold()[0] > 10 * usual[0]

    ServiceManager().ready("at work")

    assert gc.get_threshold() == usual
    assert gc.get_freeze_count() > 1000


def test_a_node_of_a_process_that_was_not_started_as_a_service_changes_nothing():
    usual, frozen = gc.get_threshold(), gc.get_freeze_count()

    ServiceManager().ready("at work")

    assert (gc.get_threshold(), gc.get_freeze_count()) == (usual, frozen)
