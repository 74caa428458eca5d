"""Files of different runs are not read as one log."""

from pathlib import Path

import pytest
from mcap.writer import Writer

from rpod_analysis import open_log
from rpod_analysis.errors import DifferentRunsError
from rpod_schemas.logs import GID_METADATA


def written(path: Path, **publishers: str) -> Path:
    """Write a log of one message a topic; publishers by topic, of which ``__`` stands for a slash."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, gid in publishers.items():
            metadata = {GID_METADATA: gid * 32} if gid else {}
            channel = writer.register_channel(f"/{topic.replace('__', '/')}", "cdr", 0, metadata)
            writer.add_message(channel, 1, b"\0\1\0\0", 1)
        writer.finish()
    return path


def test_two_runs_in_a_folder_are_refused_with_both_names_and_a_remedy(tmp_path):
    first = written(tmp_path / "a.mcap", truth__odometry="1", diagnostics="2")
    second = written(tmp_path / "b.mcap", truth__odometry="3", diagnostics="4")
    with pytest.raises(DifferentRunsError) as raised:
        open_log(tmp_path)
    assert str(raised.value).startswith(
        f"{second}: is of another run than {first}: both have truth/odometry, and no publisher in common; "
        "give the files of one run, or 'rpod report'"
    )


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"truth__odometry": "1", "pmd__info": "2"}, {"truth__odometry": "3", "pmd__info": "2"}),
        ({"truth__odometry": "1", "diagnostics": "2"}, {"pmd__info": "3", "diagnostics": "4"}),
        ({"truth__odometry": ""}, {"truth__odometry": "1"}),
    ],
    ids=["a service was started again", "other topics", "another program's log"],
)
def test_files_that_can_be_of_one_run_are_read_as_one(tmp_path, first, second):
    with open_log(written(tmp_path / "a.mcap", **first), written(tmp_path / "b.mcap", **second)) as log:
        assert sum(topic.count for topic in log.topics.values()) == len(first) + len(second)


def test_a_part_joins_runs_whose_publishers_it_has_both(tmp_path):
    written(tmp_path / "a.mcap", truth__odometry="1", pmd__info="2")
    written(tmp_path / "b.mcap", truth__odometry="3", lidar__info="4")
    written(tmp_path / "c.mcap", pmd__info="2", lidar__info="4")
    with open_log(tmp_path) as log:
        assert len(log.paths) == 3
