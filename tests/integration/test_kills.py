"""Two kills of each service in one facility: the one in reserve takes over, and each log is right about it.

``make kills`` does the same a hundred times, and measures the times, for which a test has no quiet machine.
"""

from random import Random

import pytest

from endurance.facility import SERVICES, kept_facility
from endurance.kills import Kill, desk

KILLS = 2
MOST_LOST_S = 1.0
"""The logger writes to the disk at least once a second (``sync_interval_s``)."""


@pytest.fixture(scope="module")
def killed(tmp_path_factory) -> dict[str, list[Kill]]:
    """Kills by service, one after the other, so that a reserve gets warm while others are killed."""
    random, done = Random(1), {name: [] for name in SERVICES}
    folder = tmp_path_factory.mktemp("kills")
    lidar = kept_facility(folder, sensor="lidar", rate_hz=5.0, reserve=True)
    with lidar as facility, desk(facility, reserve=True) as at:
        assert at.settle() == ()
        for _ in range(KILLS):
            for name in SERVICES:
                done[name].append(at.kill(name, random))
        assert at.settle() == ()
    return done


@pytest.mark.parametrize("service", SERVICES)
def test_after_each_kill_the_target_is_tracked_again_and_the_log_is_right_about_it(killed, service):
    assert [kill.wrong for kill in killed[service]] == [()] * KILLS
    assert max(kill.lost_s for kill in killed[service]) <= MOST_LOST_S


@pytest.mark.parametrize("service", SERVICES)
def test_the_process_in_reserve_takes_over_each_time(killed, service):
    assert [kill.from_reserve for kill in killed[service]] == [True] * KILLS
