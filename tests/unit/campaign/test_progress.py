import pytest
from counting_campaign import CAMPAIGN, CountingOptions

from rpod.campaign import progress
from rpod_campaign.engine.run import prepare


@pytest.fixture
def lines(tmp_path, monkeypatch, capsys):
    """Return a function that runs two cells with three trials each, and returns the lines that are shown.

    A trial of the second cell takes nine times as long as one of the first.
    """

    def run(*, as_json: bool, trial_s: float) -> list[str]:
        now_s = 0.0
        monkeypatch.setattr(progress.time, "monotonic", lambda: now_s)
        prepared = prepare(CAMPAIGN, CountingOptions(trials=3), out=tmp_path, version="1")
        with progress.CampaignProgress(prepared, as_json=as_json) as shown:
            for task in prepared.tasks():
                now_s += (1.0, 9.0)[task.cell] * trial_s
                shown.one(task.cell)
        return capsys.readouterr().err.splitlines()

    return run


def test_the_time_left_follows_from_each_cells_own_trials(lines):
    assert lines(as_json=False, trial_s=60.0)[1:] == [
        "1 of 6 trials, 5.0 min left",
        "2 of 6 trials, 20.0 min left",
        "3 of 6 trials, 19.0 min left",
        "4 of 6 trials, 18.0 min left",
        "5 of 6 trials, 9.0 min left",
        "6 of 6 trials, 0.0 min left",
    ]
    assert lines(as_json=False, trial_s=3600.0)[2] == "2 of 6 trials, 20.0 h left"


def test_with_json_there_is_a_line_each_minute_and_none_for_a_short_campaign(lines):
    assert lines(as_json=True, trial_s=1.9) == []
    assert lines(as_json=True, trial_s=6.0) == ["2 of 6 trials, 2.0 min left", "5 of 6 trials, 0.9 min left"]
