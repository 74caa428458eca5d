"""What a log is beside its messages: names of its metadata records and what they hold (ICD section 5).

Values of metadata records are JSON unless said otherwise. A record may stand in a file more than
once, early for the case that the process dies and again at the close: the last one counts.
"""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import Config

PROFILE = "ros2"
SCHEMA_ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"
OPAQUE = "opaque"
"""Schema name of what was recorded as it came, from keys that are not ROS topics."""
OPAQUE_ENCODING = "application/octet-stream"
"""Its message encoding."""

SOFTWARE = "software"
"""Record of plain text: ``name``, ``version``, and ``target_digest`` where a service told it."""
CONFIGURATION = "configuration"
"""Record of each service's resolved configuration, by instance."""
STATUS = "status"
"""Record of each service's last status without its configuration, by instance."""
COUNTS = "counts"
"""Record of a ``TopicCount`` for each topic, by the channel's topic; only in a file that was closed."""
RECOVERY = "recovery"
"""Record of a ``Recovery`` under ``recovery``; only in a file that was recovered from a damaged one."""

QOS_METADATA = "offered_qos_profiles"
"""Channel metadata: quality of service in rosbag2's YAML."""
HASH_METADATA = "topic_type_hash"
"""Channel metadata: RIHS01 hash of the type, as rosbag2 names it."""

Total = Annotated[int, Field(ge=0)]


class TopicCount(Config):
    """What became of a topic's messages while a file was open."""

    received: Total = 0
    """Arrived at the logger."""
    written: Total = 0
    """In the file, without the repeated ones."""
    repeated: Total = 0
    """Latched messages from before the file, which it opens with."""
    missed: Total = 0
    """Gaps in the publishers' sequence numbers: never arrived."""
    duplicates: Total = 0
    """Arrived again, left out."""

    @property
    def lost(self) -> int:
        """Arrived and yet not in the file: no room in the queue, or the disk failed."""
        return self.received - self.written


class RecoveredTopic(Config):
    """What a recovered log has of a topic."""

    messages: Total = 0
    """In the recovered log."""
    lost: Total = 0
    """Estimated: by the summary where it is whole, else by indexes, sequence numbers and rate."""
    last_ns: int | None = None
    """Arrival of the last message; None where there is none."""


class Recovery(Config):
    """What could be had of a damaged log."""

    source: str
    """The damaged file; never touched."""
    out: str
    """The new file."""
    size_bytes: Total
    """Of the damaged file."""
    unreadable_bytes: Total
    """Of them, those that are no whole record: damaged, cut, or garbage."""
    damaged_places: Total
    """How many stretches these are."""
    closed: bool
    """Whether the end of the file is there; if not, nobody knows what came after it."""
    messages: Total
    """In the new file."""
    without_definition: Total
    """Messages left out because their channel's definition is lost."""
    topics: dict[str, RecoveredTopic]
    """By the channel's topic."""

    @property
    def whole(self) -> bool:
        """Whether nothing was lost."""
        return self.closed and not self.unreadable_bytes and not self.without_definition
