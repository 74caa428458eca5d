"""CDR by rosbags: from bytes to messages with views of them, and back.

Messages are rosbags' dataclasses for the ROS 2 types and the project's own. Decoding a
``memoryview`` leaves image and point data as read-only views of it.
"""

import re
import struct
from functools import cache
from importlib import resources
from typing import Any

from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.service_types import service_types

_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}
"""Layouts of a stamp by the byte order in the encapsulation header."""
_SEPARATOR = f"{'=' * 80}\n"
"""Line between the definitions of a type and of the types that it needs."""
NANOSECONDS = 1_000_000_000
_TYPE_NAME = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", re.ASCII)
"""A type's name. rosbags makes a class of a definition by running code that contains the name."""
MOST_DEFINITION_BYTES = 1 << 20
"""Longest definition that is learnt; the longest of the common ROS 2 types has some 10 kB."""


@cache
def typestore() -> Typestore:
    """Return the type store: ROS 2 Humble's types, the same as Kilted's here, its services, and rpod_msgs."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    own: dict[str, Any] = dict(service_types())
    for type_name, text in _own_definitions().items():
        own |= get_types_from_msg(text, type_name)
    store.register(own)
    return store


@cache
def _own_definitions() -> dict[str, str]:
    """Return the texts of the project's ``.msg`` files by type."""
    files = sorted(resources.files("rpod_msgs").joinpath("msg").iterdir(), key=lambda item: item.name)
    return {f"rpod_msgs/msg/{file.name.removesuffix('.msg')}": file.read_text("utf-8") for file in files}


@cache
def _older_layouts() -> dict[str, Typestore]:
    """Return type stores that read messages as earlier versions of the project wrote them, by type."""
    text = resources.files("rpod_msgs").joinpath("older", "EstimatorStatus_1.msg").read_text("utf-8")
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(text, "rpod_msgs/msg/EstimatorStatus"))
    return {"rpod_msgs/msg/EstimatorStatus": store}


def is_known(type_name: str) -> bool:
    """Return whether messages of a type can be encoded and decoded."""
    return type_name in typestore().types


def learn(type_name: str, text: str | bytes) -> None:
    """Register a type by its ``ros2msg`` definition; a type that is already known is not changed.

    A text that is no valid definition is not registered: its messages stay bytes, and decoding them fails.
    """
    if is_known(type_name) or len(text) > MOST_DEFINITION_BYTES:
        return
    try:
        found = get_types_from_msg(text if isinstance(text, str) else text.decode(), type_name)
        if all(_TYPE_NAME.fullmatch(name) for name in found):
            typestore().register({name: fields for name, fields in found.items() if not is_known(name)})
    except (UnicodeDecodeError, TypesysError, SyntaxError, ValueError, RecursionError):
        return


@cache
def message_class(type_name: str) -> Any:
    """Return the dataclass of a message type, as ``std_msgs/msg/Header``."""
    return typestore().types[type_name]


@cache
def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a message type, or of a service with request, response and event."""
    return typestore().hash_rihs01(type_name)


@cache
def definition(type_name: str) -> str:
    """Return the ``ros2msg`` definition of a type with all that it needs, for logs.

    The definition of one of the project's own types is the text of its file. There each constant stands right
    before the field whose value it names, and Foxglove finds the names of values by this order; a generated
    text has all constants first.
    """
    text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    generated, *needed = text.split(_SEPARATOR)
    return _SEPARATOR.join([_own_definitions().get(type_name, generated), *needed])


def encode(message: Any) -> bytearray:
    """Return the little-endian CDR bytes of a message, with its encapsulation header."""
    return typestore().serialize_cdr(message, message.__msgtype__).obj  # type: ignore[return-value]


def decode(payload: bytes | memoryview, type_name: str) -> Any:
    """Return the message of its CDR bytes; its arrays are views of ``payload``.

    Raises:
        MessageRejectedError: the bytes are truncated, malformed, or big-endian beyond what is read.
    """
    if len(payload) < 4 or payload[0] != 0 or payload[1] not in (0, 1):
        raise MessageRejectedError(Reason.MALFORMED, f"no CDR encapsulation header in {len(payload)} bytes")
    try:
        return _deserialised(payload, type_name)
    except Exception as error:  # the generated reader raises whatever the bytes provoke
        text = str(error) or type(error).__name__
        raise MessageRejectedError(
            Reason.MALFORMED, f"{type_name} of {len(payload)} bytes: {text}"
        ) from error


def _deserialised(payload: bytes | memoryview, type_name: str) -> Any:
    """Return a message of the current layout, or of an earlier, shorter one if the bytes do not fit."""
    try:
        return typestore().deserialize_cdr(payload, type_name)
    except Exception:
        if type_name not in _older_layouts():
            raise
        return _older_layouts()[type_name].deserialize_cdr(payload, type_name)


STAMP_END = 12
"""End of the encapsulation header and the stamp in the bytes of a message that begins with a header."""


def peek_stamp(payload: bytes | bytearray | memoryview) -> int:
    """Return the stamp, ns, of an encoded message that begins with a std_msgs/Header.

    Raises:
        MessageRejectedError: the bytes are too few, or hold no valid stamp.
    """
    if len(payload) < STAMP_END or payload[0] != 0 or payload[1] not in _STAMP:
        raise MessageRejectedError(Reason.MALFORMED, f"no CDR header with a stamp in {len(payload)} bytes")
    seconds, nanoseconds = _STAMP[payload[1]].unpack_from(payload, 4)
    return checked_stamp(seconds, nanoseconds)


def restamped(payload: bytes | bytearray | memoryview, shift_ns: int) -> bytearray:
    """Return a message that begins with a stamp, moved in time by ``shift_ns``.

    Raises:
        MessageRejectedError: the message has no valid stamp.
    """
    seconds, nanoseconds = divmod(peek_stamp(payload) + shift_ns, NANOSECONDS)
    moved = bytearray(payload)
    _STAMP[payload[1]].pack_into(moved, 4, seconds, nanoseconds)
    return moved


@cache
def begins_with_stamp(type_name: str) -> bool:
    """Return whether messages of a type begin with a stamp."""
    _, kind = typestore().fielddefs[type_name][1][0]
    return kind[1] in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")


def checked_stamp(seconds: int, nanoseconds: int) -> int:
    """Return a builtin_interfaces/Time as ns. Raises ``MessageRejectedError`` if it is not a valid time."""
    if seconds < 0 or not 0 <= nanoseconds < NANOSECONDS:
        text = f"stamp is {seconds} s {nanoseconds} ns, needs no negative number and less than a second in ns"
        raise MessageRejectedError(Reason.MALFORMED, text)
    return int(seconds) * NANOSECONDS + int(nanoseconds)
