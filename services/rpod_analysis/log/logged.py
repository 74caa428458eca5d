"""One message of a log, as the logger wrote it."""

from dataclasses import dataclass
from typing import Any

from rpod_schemas.rmw.cdr import decode


@dataclass(frozen=True, slots=True)
class Logged:
    """One message of a log."""

    topic: str
    type: str
    """ROS 2 type, for example ``sensor_msgs/msg/Image``."""
    log_ns: int
    """Time of arrival at the logger, ns."""
    publish_ns: int
    """Source stamp in the attachment, ns."""
    sequence: int
    """Sequence number in the attachment."""
    payload: bytes
    gid: str = ""
    """Identifier of the publisher, hexadecimal digits; empty if the log does not tell."""
    session: str = ""
    """Zenoh identity of the publisher's session; empty if it is not known."""

    def decode(self) -> Any:
        """Return the ROS message, whose arrays are views of the payload. Raises ``MessageRejectedError``."""
        return decode(memoryview(self.payload), self.type)
