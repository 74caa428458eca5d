"""Types of ROS 2 services for the type store: those of ROS that are served, and the project's own.

The type of a service has three parts, ``_Request``, ``_Response`` and ``_Event``, and its RIHS01 hash is
that of a type with these three as fields (REP 2011 and 2016; rosidl_generator_type_description).
"""

from importlib import resources

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Fielddefs, FieldDesc, Typesdict
from rosbags.typesys import get_types_from_msg

TRIGGER = "std_srvs/srv/Trigger"
RESET = "rpod_msgs/srv/ResetEstimator"
GET_PARAMETERS = "rcl_interfaces/srv/GetParameters"
GET_PARAMETER_TYPES = "rcl_interfaces/srv/GetParameterTypes"
LIST_PARAMETERS = "rcl_interfaces/srv/ListParameters"
DESCRIBE_PARAMETERS = "rcl_interfaces/srv/DescribeParameters"
SET_PARAMETERS = "rcl_interfaces/srv/SetParameters"
SET_PARAMETERS_ATOMICALLY = "rcl_interfaces/srv/SetParametersAtomically"

_INFO = "service_msgs/msg/ServiceEventInfo"
_INFO_TEXT = """
uint8 event_type
builtin_interfaces/Time stamp
uint8[16] client_gid
int64 sequence_number
"""
"""ROS writes the gid as ``char[16]``, which its interface language maps to uint8."""

_OF_ROS = {
    TRIGGER: "---\nbool success\nstring message\n",
    GET_PARAMETERS: "string[] names\n---\nrcl_interfaces/ParameterValue[] values\n",
    GET_PARAMETER_TYPES: "string[] names\n---\nuint8[] types\n",
    LIST_PARAMETERS: (
        "uint64 DEPTH_RECURSIVE=0\nstring[] prefixes\nuint64 depth\n---\n"
        "rcl_interfaces/ListParametersResult result\n"
    ),
    DESCRIBE_PARAMETERS: "string[] names\n---\nrcl_interfaces/ParameterDescriptor[] descriptors\n",
    SET_PARAMETERS: (
        "rcl_interfaces/Parameter[] parameters\n---\nrcl_interfaces/SetParametersResult[] results\n"
    ),
    SET_PARAMETERS_ATOMICALLY: (
        "rcl_interfaces/Parameter[] parameters\n---\nrcl_interfaces/SetParametersResult result\n"
    ),
}
"""Definitions of std_srvs 5.5.1 and rcl_interfaces 2.3.0 (Kilted)."""


def service_types() -> Typesdict:
    """Return the field definitions of all services with their parts, by type name."""
    types = dict(get_types_from_msg(_INFO_TEXT, _INFO))
    for type_name, text in (_OF_ROS | _own_definitions()).items():
        types |= _parts(type_name, text)
    return types


def _own_definitions() -> dict[str, str]:
    files = resources.files("rpod_msgs").joinpath("srv").iterdir()
    return {f"rpod_msgs/srv/{file.name.removesuffix('.srv')}": file.read_text("utf-8") for file in files}


def _parts(type_name: str, text: str) -> Typesdict:
    """Return a service and its three parts from the text of its ``.srv`` file."""
    request, _, response = f"\n{text}".partition("\n---\n")
    event: Fielddefs = [
        ("info", (Nodetype.NAME, _INFO)),
        ("request", _at_most_one(f"{type_name}_Request")),
        ("response", _at_most_one(f"{type_name}_Response")),
    ]
    whole: Fielddefs = [
        (f"{part}_message", (Nodetype.NAME, f"{type_name}_{part.capitalize()}"))
        for part in ("request", "response", "event")
    ]
    return {
        f"{type_name}_Request": _fields(type_name, request),
        f"{type_name}_Response": _fields(type_name, response),
        f"{type_name}_Event": ([], event),
        type_name: ([], whole),
    }


def _fields(type_name: str, text: str) -> tuple[list, Fielddefs]:  # type: ignore[type-arg]
    """Return constants and fields of one part; rosbags parses messages alone, so it is named as one."""
    name = type_name.replace("/srv/", "/msg/")
    return get_types_from_msg(text, name)[name] if text.strip() else ([], [])


def _at_most_one(type_name: str) -> FieldDesc:
    return (Nodetype.SEQUENCE, ((Nodetype.NAME, type_name), 1))
