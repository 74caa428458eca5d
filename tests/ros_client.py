"""A client of ROS 2 services for tests: plain Zenoh and rosbags, and nothing of the project.

It does what rmw_zenoh's client does (``rmw_client_data.cpp``): it waits for the token of the server, asks
complete queryables by the key with the type's hash, and takes a normal reply alone.
"""

import json
import struct
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

HASHES: dict[str, str] = json.loads(
    (Path(__file__).parent / "unit" / "schemas" / "ros" / "oracle.json").read_text("utf-8")
)["hashes"]
_ATTACHMENT = struct.Struct("<qqB16s")
_STORE = get_typestore(Stores.ROS2_JAZZY)
_PARTS = {
    "std_srvs/Trigger_Request": "",
    "std_srvs/Trigger_Response": "bool success\nstring message",
    "rpod_msgs/ResetEstimator_Request": (
        "bool with_pose\ngeometry_msgs/PoseWithCovarianceStamped pose\nstring keep_gid"
    ),
    "rpod_msgs/ResetEstimator_Response": "bool success\nstring message",
    "rcl_interfaces/GetParameters_Request": "string[] names",
    "rcl_interfaces/GetParameters_Response": "rcl_interfaces/ParameterValue[] values",
    "rcl_interfaces/GetParameterTypes_Request": "string[] names",
    "rcl_interfaces/GetParameterTypes_Response": "uint8[] types",
    "rcl_interfaces/ListParameters_Request": "string[] prefixes\nuint64 depth",
    "rcl_interfaces/ListParameters_Response": "rcl_interfaces/ListParametersResult result",
    "rcl_interfaces/DescribeParameters_Request": "string[] names",
    "rcl_interfaces/DescribeParameters_Response": "rcl_interfaces/ParameterDescriptor[] descriptors",
    "rcl_interfaces/SetParameters_Request": "rcl_interfaces/Parameter[] parameters",
    "rcl_interfaces/SetParameters_Response": "rcl_interfaces/SetParametersResult[] results",
    "rcl_interfaces/SetParametersAtomically_Request": "rcl_interfaces/Parameter[] parameters",
    "rcl_interfaces/SetParametersAtomically_Response": "rcl_interfaces/SetParametersResult result",
}
for _name, _text in _PARTS.items():
    _package, _part = _name.split("/")
    _type = f"{_package}/msg/{_part}"
    _STORE.register(get_types_from_msg(_text, _type) if _text else {_type: ([], [])})


def message(type_name: str, **fields: Any) -> Any:
    """Make a message of a type, as ``rcl_interfaces/msg/Parameter``."""
    return _STORE.types[type_name](**fields)


class NoReplyError(Exception):
    """No normal reply came: a client of ROS 2 would wait on."""


class RosClient:
    """A session of another program on the bus."""

    def __init__(self, endpoint: str, domain: int = 0) -> None:
        self.domain = domain
        self.gid = bytes(range(16))
        self.replied: tuple[int, bytes] = (0, b"")
        """Sequence number and gid of the last reply."""
        self._sequence = 0
        settings = {
            "mode": "client",
            "connect": {"endpoints": [endpoint]},
            "scouting": {"multicast": {"enabled": False}},
        }
        self.session = zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.session.close()

    def tokens(self, kind: str, *, least: int = 1, timeout_s: float = 60.0) -> list[str]:
        """Return the tokens of a kind in the domain, once there are enough of them."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            replies = self.session.liveliness().get(
                f"@ros2_lv/{self.domain}/*/*/*/{kind}/**", timeout=timeout_s
            )
            found = [str(reply.ok.key_expr) for reply in replies if reply.ok]
            if len(found) >= least or time.monotonic() > deadline_s:
                return found

    def key(self, service: str, type_name: str, type_hash: str = "") -> str:
        """Return the key of a service, as ``/logger/split`` of ``std_srvs/srv/Trigger``."""
        package, _, name = type_name.split("/")
        wire = f"{package}::srv::dds_::{name}_"
        return f"{self.domain}/{service.strip('/')}/{wire}/{type_hash or HASHES[type_name]}"

    def await_service(self, service: str, timeout_s: float = 60.0) -> None:
        """Wait for the token of a service."""
        name = service.replace("/", "%")
        deadline_s = time.monotonic() + timeout_s
        while not any(f"/{name}/" in token for token in self.tokens("SS")):
            assert time.monotonic() < deadline_s, f"{service} is not there"

    def call(self, service: str, type_name: str, *, type_hash: str = "", **fields: Any) -> Any:
        """Call a service and return its response.

        Raises:
            NoReplyError: there is none, or an error reply.
        """
        self.await_service(service)
        flat = type_name.replace("/srv/", "/msg/")
        payload = _STORE.serialize_cdr(message(f"{flat}_Request", **fields), f"{flat}_Request")
        return self.send(self.key(service, type_name, type_hash), bytes(payload), f"{flat}_Response")

    def send(self, key: str, payload: bytes, response: str, attachment: bytes | None = None) -> Any:
        """Send bytes to a key, with the attachment of the next call or a given one."""
        self._sequence += 1
        own = _ATTACHMENT.pack(self._sequence, time.time_ns(), 16, self.gid)
        replies = list(
            self.session.get(
                key,
                payload=payload,
                attachment=own if attachment is None else attachment,
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=5.0,
            )
        )
        if len(replies) != 1 or replies[0].ok is None:
            raise NoReplyError([reply.err.payload.to_string() for reply in replies if reply.err])
        sample = replies[0].ok
        assert "*" in key or str(sample.key_expr) == key
        sequence, stamp_ns, size, gid = _ATTACHMENT.unpack(sample.attachment.to_bytes())
        assert size == 16
        assert abs(stamp_ns - time.time_ns()) < 60e9
        self.replied = sequence, gid
        return _STORE.deserialize_cdr(sample.payload.to_bytes(), response)

    @property
    def sequence(self) -> int:
        """Sequence number of the last call."""
        return self._sequence


def parameters(client, node, service, **fields):
    camel = "".join(part.capitalize() for part in service.split("_"))
    return client.call(f"/{node}/{service}", f"rcl_interfaces/srv/{camel}", **fields)


def assignment(name, **value):
    empty = {
        "type": 0, "bool_value": False, "integer_value": 0, "double_value": 0.0, "string_value": "",
        "byte_array_value": np.empty(0, np.uint8), "bool_array_value": np.empty(0, np.bool_),
        "integer_array_value": np.empty(0, np.int64), "double_array_value": np.empty(0, np.float64),
        "string_array_value": [],
    }  # fmt: skip
    whole = message("rcl_interfaces/msg/ParameterValue", **(empty | value))
    return message("rcl_interfaces/msg/Parameter", name=name, value=whole)
