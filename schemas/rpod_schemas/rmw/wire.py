"""Data that rmw_zenoh adds to messages: the attachment, and liveliness tokens.

Source: rmw_zenoh of Humble 0.1.2, Jazzy 0.2.5, Kilted 0.6 and later (ICD section 2).
"""

import struct
from dataclasses import dataclass
from typing import Literal

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.cdr import type_hash
from rpod_schemas.topics import ABSOLUTE_TOPICS, Endpoint, Namespace, Topic, is_wire_type, type_of_wire

_ATTACHMENT = struct.Struct("<qqB16s")
GID_BYTES = 16


@dataclass(frozen=True, slots=True)
class Attachment:
    """Sequence number from 0 or 1, source stamp, and the publisher's identity."""

    sequence: int
    stamp_ns: int
    gid: bytes

    def pack(self) -> bytes:
        """Return the 33 bytes of the wire."""
        return _ATTACHMENT.pack(self.sequence, self.stamp_ns, GID_BYTES, self.gid)


UNNUMBERED = Attachment(0, 0, bytes(GID_BYTES))
"""Attachment that replaces a missing one where none is needed."""


def unpack_attachment(data: bytes | None) -> Attachment:
    """Read an attachment.

    Raises:
        MessageRejectedError: there is none, it is of the older labelled form, or it is damaged.
    """
    if data is None:
        raise MessageRejectedError(Reason.MALFORMED, "no attachment; is the publisher rmw_zenoh or rpod?")
    if b"sequence_number" in data:
        raise MessageRejectedError(
            Reason.OLD_ATTACHMENT,
            "labelled attachment of an rmw_zenoh before Humble 0.1.2 / Jazzy 0.2.5; update the publisher",
        )
    if len(data) != _ATTACHMENT.size:
        raise MessageRejectedError(
            Reason.MALFORMED, f"attachment of {len(data)} bytes, needs {_ATTACHMENT.size}"
        )
    sequence, stamp_ns, size, gid = _ATTACHMENT.unpack(data)
    if size != GID_BYTES or sequence < 0:
        raise MessageRejectedError(
            Reason.MALFORMED,
            f"attachment with gid size {size}, sequence number {sequence}; needs {GID_BYTES}, and 0 or more",
        )
    return Attachment(sequence, stamp_ns, gid)


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"


def node_name(instance: str) -> str:
    """Return the name of an instance's node in the ROS graph, which knows no hyphens."""
    return instance.replace("-", "_")


@dataclass(frozen=True)
class GraphNode:
    """A node of the ROS graph, as its liveliness tokens show it."""

    namespace: Namespace
    session_id: str
    name: str

    def _head(self, entity: int, kind: str) -> str:
        prefix = f"/{self.namespace.prefix}" if self.namespace.prefix else ""
        session = f"@ros2_lv/{self.namespace.domain}/{self.session_id}"
        return f"{session}/0/{entity}/{kind}/%/{_mangled(prefix)}/{node_name(self.name)}"

    def node_token(self) -> str:
        """Return the token of the node itself."""
        return self._head(0, "NN")

    def endpoint_token(self, kind: Literal["MP", "MS", "SS", "SC"], entity: int, topic: Endpoint) -> str:
        """Return the token of a publisher (MP), subscriber (MS), service (SS) or client (SC)."""
        name = _mangled(self.namespace.ros_name(topic))
        qos = topic.asked if kind in ("MS", "SC") else topic.offered
        return f"{self._head(entity, kind)}/{name}/{topic.wire_type}/{type_hash(topic.type)}/{qos.token()}"


def token_pattern(namespace: Namespace, kind: str, node: str, topic: Topic | None = None) -> str:
    """Return the key expression of a node's tokens of one kind, in any session.

    Args:
        namespace: domain and ROS namespace of the node.
        kind: ``NN``, ``MP``, ``MS``; also ``SS`` and ``SC`` of ROS services, whose topic is the service.
        node: name of the node.
        topic: topic of an endpoint, in which ``*`` matches a part of the name; None for ``NN``.
    """
    prefix = f"/{namespace.prefix}" if namespace.prefix else ""
    head = f"@ros2_lv/{namespace.domain}/*/*/*/{kind}/*/{_mangled(prefix)}/{node_name(node)}"
    if topic is None:
        return head
    name = _mangled(namespace.ros_name(topic)).replace("*", "$*")
    return f"{head}/{name}/{topic.wire_type if topic.type else '*'}/*/*"


def publisher_tokens(namespace: Namespace, topic: Topic | None = None) -> str:
    """Return the key expression of the tokens of all publishers in a domain, or of those of a topic."""
    endpoint = f"{_mangled(namespace.ros_name(topic))}/{topic.wire_type}" if topic else "*/*"
    return f"@ros2_lv/{namespace.domain}/*/*/*/MP/*/*/*/{endpoint}/*/*"


EVERY_PUBLISHER = "@ros2_lv/*/*/*/*/MP/*/*/*/*/*/*/*"
"""Key expression of the tokens of all publishers in every domain."""


def place_of_token(token: str) -> tuple[int, str, str]:
    """Return the domain that an endpoint's token names, the absolute name of its topic, and its type.

    The type is empty if the token names none.
    """
    parts = token.split("/")
    domain = int(parts[1]) if parts[1].isdecimal() else -1
    wire_type = parts[10]
    return domain, parts[9].replace("%", "/"), type_of_wire(wire_type) if is_wire_type(wire_type) else ""


def session_of_token(token: str) -> str:
    """Return the Zenoh identity of the session that declared a token."""
    return token.split("/")[2]


def qos_of_token(token: str) -> str:
    """Return the quality of service that an endpoint's token states, as rmw_zenoh writes it."""
    return token.split("/")[12]


def topic_of_token(token: str, namespace: Namespace) -> Topic | None:
    """Return the topic that an endpoint's token names; None if it is not of this namespace."""
    name, wire_type = token.split("/")[9:11]
    for topic in ABSOLUTE_TOPICS:
        if (name, wire_type) == (_mangled(namespace.ros_name(topic)), topic.wire_type):
            return topic
    prefix = _mangled(f"/{namespace.prefix}/" if namespace.prefix else "/")
    if not name.startswith(prefix) or not is_wire_type(wire_type):
        return None
    return Topic(name.removeprefix(prefix).replace("%", "/"), type_of_wire(wire_type))
