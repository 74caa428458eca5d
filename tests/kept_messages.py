"""What a publisher sends through a node without a bus."""

from typing import Any

from rpod_runtime import Received
from rpod_runtime.local_node import local_node


class KeptMessages:
    """All messages that were published through ``node``, in their order."""

    def __init__(self) -> None:
        self.received: list[Received] = []
        self.node = local_node(self.received.append)

    @property
    def names(self) -> list[str]:
        """Name of the topic of each message."""
        return [received.topic.name for received in self.received]

    def of(self, name: str) -> list[Any]:
        """Return the messages of a topic, decoded."""
        return [received.decode() for received in self.received if received.topic.name == name]
