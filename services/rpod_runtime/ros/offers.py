"""Warns of publishers whose quality of service is less than a latched topic needs."""

from collections.abc import Callable

from rpod_schemas.rmw.qos import Qos
from rpod_schemas.texts import shown
from rpod_schemas.topics import Topic

_NODE, _QOS = 8, -1
"""Places of the node's name and of the quality of service in a token."""
_LONGEST = 255
"""Largest number of characters of a node's name in ROS 2."""


def offer_watch(topic: Topic, warn: Callable[[str, str], None]) -> Callable[[str], None]:
    """Return a function that takes the token of a publisher, and warns if its offer lacks something.

    ``warn`` takes a name and a text for the operator.
    """

    def take(token: str) -> None:
        parts = token.split("/")
        try:
            lacks = Qos.read(parts[_QOS]).lacks(topic.asked)
        except ValueError:
            return  # a form of a later rmw_zenoh
        if lacks:
            warn(
                f"qos/{topic.name}",
                f"node {shown(parts[_NODE], _LONGEST)} does not publish it as {' and '.join(lacks)}, so that "
                "what it sent before this service started is missing; set its publisher to RELIABLE and "
                "TRANSIENT_LOCAL",
            )

    return take
