"""Makes ``oracle.json``: what ROS 2's own packages, and another client, write for the facility's services.

It runs in an environment of its own, never in that of the project (Linux, Python 3.11):

    python -m venv oracle
    oracle/bin/pip install ros-rclpy ros-rmw-fastrtps-cpp ros-std-srvs ros-rcl-interfaces ros-std-msgs \\
        ros-geometry-msgs ros-rosidl-generator-type-description ros-rosidl-adapter catkin_pkg zenoh-ros2-sdk
    oracle/bin/python tests/unit/schemas/ros/make_oracle.py

- ``hashes``: of the packages of ROS, read from the type descriptions in their wheels; of rpod_msgs, computed
  from its files by rosidl_adapter, rosidl_parser and rosidl_generator_type_description, the steps of a build
  with colcon.
- ``cdr``: bytes by ``rclpy.serialization`` with rmw_fastrtps_cpp. Padding is whatever the memory held. Their
  number is its estimate, a few too many after empty sequences; rmw_zenoh sends only those that were written.
- ``tokens``, ``key``, ``attachment``: by zenoh-ros2-sdk.

No part of it is a node with rmw_zenoh.
"""

import json
import os
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

os.environ["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"

import rclpy
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import Log, Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.serialization import serialize_message
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_adapter.srv import convert_srv_to_idl
from rosidl_generator_type_description import generate_type_hash
from std_srvs.srv import Trigger
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, topic_keyexpr
from zenoh_ros2_sdk.utils import ros2_to_dds_type

HERE = Path(__file__).parent
RPOD_MSGS = HERE.parents[3] / "schemas" / "rpod_msgs"
SHARE = Path(rclpy.__file__).parents[4] / "share"
PACKAGES = (
    "ros-rclpy", "ros-rmw-fastrtps-cpp", "ros-std-srvs", "ros-rcl-interfaces", "ros-rosidl-adapter",
    "ros-rosidl-parser", "ros-rosidl-generator-type-description", "zenoh-ros2-sdk",
)  # fmt: skip
GID = bytes(range(16))
OF_ROS = (
    "std_srvs/srv/Trigger",
    "rcl_interfaces/srv/GetParameters",
    "rcl_interfaces/srv/GetParameterTypes",
    "rcl_interfaces/srv/ListParameters",
    "rcl_interfaces/srv/DescribeParameters",
    "rcl_interfaces/srv/SetParameters",
    "rcl_interfaces/srv/SetParametersAtomically",
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
)


def hash_in(folder: Path, type_name: str) -> str:
    description = json.loads((folder / f"{type_name}.json").read_text("utf-8"))
    return next(each["hash_string"] for each in description["type_hashes"] if each["type_name"] == type_name)


def hashes_of_rpod_msgs() -> dict[str, str]:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "rpod_msgs"
        root.mkdir()
        idl = []
        for kind, convert in (("msg", convert_msg_to_idl), ("srv", convert_srv_to_idl)):
            (root / kind).mkdir()
            for file in sorted((RPOD_MSGS / kind).glob(f"*.{kind}")):
                convert(RPOD_MSGS, "rpod_msgs", file.relative_to(RPOD_MSGS), root / kind)
                idl.append(f"{root}:{kind}/{file.stem}.idl")
        arguments = root / "arguments.json"
        needed = ("builtin_interfaces", "std_msgs", "geometry_msgs", "service_msgs")
        arguments.write_text(
            json.dumps(
                {
                    "package_name": "rpod_msgs",
                    "output_dir": str(root),
                    "idl_tuples": idl,
                    "include_paths": [f"{package}:{SHARE / package}" for package in needed],
                }
            )
        )
        generate_type_hash(str(arguments))
        made = [f"rpod_msgs/{each.split(':')[1].removesuffix('.idl')}" for each in idl]
        return {name: hash_in(Path(folder), name) for name in made}


def value(kind: int, **field: Any) -> ParameterValue:
    return ParameterValue(type=kind, **field)


VALUES = (
    value(ParameterType.PARAMETER_NOT_SET),
    value(ParameterType.PARAMETER_BOOL, bool_value=True),
    value(ParameterType.PARAMETER_INTEGER, integer_value=-7),
    value(ParameterType.PARAMETER_DOUBLE, double_value=0.25),
    value(ParameterType.PARAMETER_STRING, string_value="tcp/127.0.0.1:7447"),
    value(ParameterType.PARAMETER_BYTE_ARRAY, byte_array_value=[b"\x01", b"\xff"]),
    value(ParameterType.PARAMETER_BOOL_ARRAY, bool_array_value=[True, False]),
    value(ParameterType.PARAMETER_INTEGER_ARRAY, integer_array_value=[1, -2]),
    value(ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[0.5, 1.5]),
    value(ParameterType.PARAMETER_STRING_ARRAY, string_array_value=["a", "bcd"]),
)
LEVEL = Parameter(name="log_level", value=value(ParameterType.PARAMETER_STRING, string_value="debug"))

MESSAGES = {
    "std_srvs/srv/Trigger_Request": Trigger.Request(),
    "std_srvs/srv/Trigger_Response": Trigger.Response(success=True, message="done"),
    "rcl_interfaces/srv/GetParameters_Request": GetParameters.Request(names=["a", "bus.domain"]),
    "rcl_interfaces/srv/GetParameters_Response": GetParameters.Response(values=list(VALUES)),
    "rcl_interfaces/srv/GetParameterTypes_Response": GetParameterTypes.Response(types=[0, 4, 9]),
    "rcl_interfaces/srv/ListParameters_Request": ListParameters.Request(prefixes=["bus"], depth=1),
    "rcl_interfaces/srv/ListParameters_Response": ListParameters.Response(),
    "rcl_interfaces/srv/DescribeParameters_Response": DescribeParameters.Response(),
    "rcl_interfaces/srv/SetParameters_Request": SetParameters.Request(parameters=[LEVEL]),
    "rcl_interfaces/srv/SetParameters_Response": SetParameters.Response(),
    "rcl_interfaces/srv/SetParametersAtomically_Response": SetParametersAtomically.Response(),
    "rcl_interfaces/msg/Log": Log(
        stamp=Time(sec=12, nanosec=34),
        level=30,
        name="lab.logger",
        msg="full",
        file="a.py",
        function="f",
        line=7,
    ),
    "rcl_interfaces/msg/ParameterEvent": ParameterEvent(
        stamp=Time(sec=12, nanosec=34), node="/lab/logger", changed_parameters=[LEVEL]
    ),
}


def token(kind: EntityKind, node: str, type_hash: str, qos: str) -> str:
    entity = EndpointEntity(
        node=NodeEntity(3, "abc", 0, node, "/lab"),
        entity_id=5,
        kind=kind,
        name="/lab/my_logger/split",
        dds_type_name=ros2_to_dds_type("std_srvs/srv/Trigger"),
        type_hash=type_hash,
        qos=qos,
    )
    return endpoint_liveliness_keyexpr(entity)


def main() -> None:
    hashes = {name: hash_in(SHARE, name) for name in OF_ROS}
    trigger = hashes["std_srvs/srv/Trigger"]
    default = "::,10:,:,:,,"
    oracle = {
        "made_by": "make_oracle.py, which says how",
        "versions": {
            name: version(name)
            for name in PACKAGES
        },
        "hashes": hashes | hashes_of_rpod_msgs(),
        "cdr": {name: serialize_message(message).hex() for name, message in MESSAGES.items()},
        "tokens": {
            "SS": token(EntityKind.SERVICE, "my_logger", trigger, default),
            "SC": token(EntityKind.CLIENT, "my_logger", trigger, default),
        },
        "key": topic_keyexpr(3, "/lab/my_logger/split", ros2_to_dds_type("std_srvs/srv/Trigger"), trigger),
        "attachment": {
            "sequence": 42,
            "stamp_ns": 1_700_000_000_123_456_789,
            "gid": GID.hex(),
            "bytes": Attachment(42, 1_700_000_000_123_456_789, GID).to_bytes().hex(),
        },
    }  # fmt: skip
    (HERE / "oracle.json").write_text(json.dumps(oracle, indent=1) + "\n")


if __name__ == "__main__":
    main()
