"""A whole log of an older version is read and replayed by the present one."""

import shutil
from pathlib import Path

import pytest

from rpod_analysis import open_log
from rpod_analysis.replay import compare, configured_estimator, replay
from rpod_schemas.topics import STATUS

KEPT = Path(__file__).parents[3] / "recordings" / "old_logs" / "icd-1.1.mcap"


@pytest.fixture
def old(tmp_path):
    return shutil.copy(KEPT, tmp_path / "old.mcap")


def test_a_log_of_icd_1_1_replays_by_its_own_configuration(old):
    with open_log(old) as log:
        assert len(list(log.statuses(STATUS))) == 4
        replayed = replay(log, configured_estimator(log))
        found = compare(log, replayed)
    assert replayed.frames == 4
    assert found.new is not None
    assert found.old is not None
    assert found.new.error is not None
    assert found.new.estimates == found.old.estimates == 3
    assert found.new.error.attitude_deg.max < 0.5
    assert found.new.error.position_m.max < 0.05
