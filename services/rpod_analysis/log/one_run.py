"""Whether several files can be of one run. Those of different runs, read as one log, would be mixed.

A logger names the publisher of each channel by its gid, which is new at each start. The parts of a run have
publishers in common, even if the logger or another service was started again between them. Two loggers of one
bus have the same publishers, or other topics. Two runs have the same topics, and no publisher in common.
"""

from collections.abc import Sequence

from rpod_analysis.errors import DifferentRunsError
from rpod_analysis.log.log_file import LogFile
from rpod_schemas.logs import GID_METADATA
from rpod_schemas.topics import OF_MANY, TF_STATIC

_OF_ALL_RUNS = tuple(f"/{topic.name}" for topic in (*OF_MANY, TF_STATIC))
"""Ends of the names of topics that any set of services has."""


def check_one_run(files: Sequence[LogFile]) -> None:
    """Raise ``DifferentRunsError`` if two files have a topic of one publisher in common, but no publisher.

    Files of other programs, which name no publishers, can be of any run.
    """
    runs: list[tuple[LogFile, set[str], set[str]]] = []  # first file, publishers, topics
    for file in files:
        publishers, topics = _named(file)
        joined = [run for run in runs if run[1] & publishers]
        for run in joined[1:]:
            publishers |= run[1]
            topics |= run[2]
            runs.remove(run)
        if joined:
            joined[0][1].update(publishers)
            joined[0][2].update(topics)
        elif publishers:
            runs.append((file, publishers, topics))
    for number, (file, _, topics) in enumerate(runs):
        for other, _, others in runs[:number]:
            if same := topics & others:
                raise DifferentRunsError(other.path, file.path, min(same).removeprefix("/"))


def _named(file: LogFile) -> tuple[set[str], set[str]]:
    """Return the gids of a file's publishers, and the topics that they have and that not any service has."""
    channels = [each for each in file.summary.channels.values() if each.metadata.get(GID_METADATA)]
    topics = {each.topic for each in channels if not f"/{each.topic}".endswith(_OF_ALL_RUNS)}
    return {each.metadata[GID_METADATA] for each in channels}, topics
