"""The topic registry: every topic of the ICD, its type, and how its key is built.

Nothing else in the project writes a topic name, a key expression or a quality of service as a
string. A test holds this table equal to the one in ``schemas/ICD.md``.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

from rpod_schemas.rmw import qos
from rpod_schemas.rmw.cdr import is_known, type_hash
from rpod_schemas.rmw.qos import Qos

SENSOR_CACHE = 90
"""Number of images or point clouds that a publisher keeps for receivers that missed them: two seconds."""
SMALL_CACHE = 500
"""Number of small messages that a publisher keeps: two seconds of truth."""


class Endpoint(Protocol):
    """A name in the key space: the common base of topics and services."""

    @property
    def name(self) -> str:
        """Name without a slash at its start, in the facility's namespace unless it is absolute."""
        ...

    @property
    def type(self) -> str:
        """ROS 2 type."""
        ...

    @property
    def absolute(self) -> bool:
        """Whether the name stands outside of all namespaces."""
        ...

    @property
    def wire_type(self) -> str:
        """Type as DDS names it."""
        ...

    @property
    def offered(self) -> Qos:
        """Quality of service that publishers and services offer."""
        ...

    @property
    def asked(self) -> Qos:
        """Quality of service that subscribers and clients ask for."""
        ...


@dataclass(frozen=True)
class Topic:
    """A topic of the data plane; ``name`` may hold ``<camera>`` or ``<lidar>`` for the sensor's name."""

    name: str
    type: str
    """ROS 2 type, as ``sensor_msgs/msg/Image``."""
    latched: bool = False
    """Whether the quality of service is RELIABLE, TRANSIENT_LOCAL, KEEP_LAST 1."""
    absolute: bool = False
    """Whether the name stands outside of all namespaces, as ROS 2 has it for ``/rosout``."""
    profile: Qos | None = None
    """Quality of service that publishers offer, where ROS 2 prescribes one."""

    def of(self, sensor: str) -> "Topic":
        """Return this topic for a sensor: ``<camera>/camera_info`` of ``pmd`` is ``pmd/camera_info``."""
        if not self.name.startswith("<"):
            raise ValueError(f"{self.name} belongs to no sensor")
        return self.under(sensor)

    def under(self, prefix: str) -> "Topic":
        """Return an estimate's topic under a prefix: ``estimate/pose`` under ``b`` is ``b/pose``."""
        return replace(self, name=f"{prefix}/{self.name.split('/', 1)[1]}")

    def at(self, frame: str) -> "Topic":
        """Return this topic with a frame's name for ``<frame>``; a topic of no frame stays as it is."""
        return replace(self, name=self.name.replace("<frame>", frame))

    def covers(self, other: "Topic") -> bool:
        """Return whether a topic is this one, or matches it with ``*`` for any part of its name."""
        mine, theirs = self.name.split("/"), other.name.split("/")
        return (
            self.type == other.type
            and len(mine) == len(theirs)
            and all(pattern in ("*", part) for pattern, part in zip(mine, theirs, strict=True))
        )

    @property
    def bulky(self) -> bool:
        """Whether its messages are large: images and point clouds."""
        return self.type in (_IMAGE, COMPRESSED_IMAGE, _POINTS)

    @property
    def kept(self) -> int:
        """Number of messages that a publisher keeps for receivers that missed them, or start later."""
        if self.latched or (self.profile and self.profile.transient_local):
            return self.offered.depth
        return SENSOR_CACHE if self.bulky else SMALL_CACHE

    @property
    def offered(self) -> Qos:
        """Quality of service that publishers offer."""
        return self.profile or (qos.LATCHED if self.latched else Qos())

    @property
    def asked(self) -> Qos:
        """Quality of service that subscribers ask for: that of any publisher, unless the topic is latched."""
        return qos.LATCHED if self.latched else qos.ANY_PUBLISHER

    @property
    def wire_type(self) -> str:
        """Type as DDS names it: ``sensor_msgs::msg::dds_::Image_``."""
        return wire_type(self.type)


@dataclass(frozen=True)
class Service:
    """A ROS 2 service of a node: ``Service("logger/split", "std_srvs/srv/Trigger")``."""

    name: str
    type: str
    """ROS 2 type."""
    offered: Qos = qos.SERVICE
    absolute: bool = False

    @property
    def asked(self) -> Qos:
        """Quality of service that clients ask for."""
        return self.offered

    @property
    def wire_type(self) -> str:
        """Type as DDS names it: ``std_srvs::srv::dds_::Trigger_``."""
        return wire_type(self.type)


_IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
_POINTS = "sensor_msgs/msg/PointCloud2"

TRUTH = Topic("truth/odometry", "nav_msgs/msg/Odometry")
TRUTH_JOINTS = Topic("truth/joints", "sensor_msgs/msg/JointState")
REFERENCE = Topic("motion/reference", "nav_msgs/msg/Odometry")
SUN = Topic("environment/sun", "geometry_msgs/msg/Vector3Stamped", latched=True)
TF_STATIC = Topic("tf_static", "tf2_msgs/msg/TFMessage", latched=True)
TF = Topic("tf", "tf2_msgs/msg/TFMessage")
CLOCK = Topic("clock", "rosgraph_msgs/msg/Clock")
DEPTH = Topic("<camera>/depth/image_raw", _IMAGE)
AMPLITUDE = Topic("<camera>/amplitude/image_raw", _IMAGE)
DEPTH_SIGMA = Topic("<camera>/depth_sigma/image_raw", _IMAGE)
CAMERA_INFO = Topic("<camera>/camera_info", "sensor_msgs/msg/CameraInfo")
PHASE = Topic("<camera>/phase/image_raw", _IMAGE)
PMD_INFO = Topic("<camera>/info", "rpod_msgs/msg/PmdInfo", latched=True)
POINTS = Topic("<lidar>/points", _POINTS)
LIDAR_INFO = Topic("<lidar>/info", "rpod_msgs/msg/LidarInfo", latched=True)
ESTIMATE = Topic("estimate/odometry", "nav_msgs/msg/Odometry")
ESTIMATE_POSE = Topic("estimate/pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
ESTIMATE_FRAME = Topic("estimate/frames/<frame>", "geometry_msgs/msg/PoseWithCovarianceStamped")
ESTIMATE_JOINTS = Topic("estimate/joints", "sensor_msgs/msg/JointState")
CONTRADICTION = Topic("estimate/contradiction", _IMAGE)
VALIDITY = Topic("estimate/validity", "rpod_msgs/msg/EstimateValidity")
INTEGRITY = Topic("estimate/integrity", "rpod_msgs/msg/Integrity")
STATUS = Topic("estimate/status", "rpod_msgs/msg/EstimatorStatus")
COMMAND = Topic("guidance/command", "geometry_msgs/msg/AccelWithCovarianceStamped")
IMU = Topic("chaser/imu", "sensor_msgs/msg/Imu")
BODY = Topic("bodies/<frame>/odometry", "nav_msgs/msg/Odometry")
FAULTS = Topic("faults", "diagnostic_msgs/msg/DiagnosticArray", latched=True)
DIAGNOSTICS = Topic("diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
ROSOUT = Topic("rosout", "rcl_interfaces/msg/Log", absolute=True, profile=qos.ROSOUT)
PARAMETER_EVENTS = Topic(
    "parameter_events", "rcl_interfaces/msg/ParameterEvent", absolute=True, profile=qos.PARAMETERS
)

TOPICS: tuple[Topic, ...] = (
    TRUTH, TRUTH_JOINTS, REFERENCE, SUN, TF_STATIC, TF, CLOCK, DEPTH, AMPLITUDE, DEPTH_SIGMA,
    CAMERA_INFO, PHASE, PMD_INFO, POINTS, LIDAR_INFO, ESTIMATE, ESTIMATE_POSE, ESTIMATE_FRAME,
    ESTIMATE_JOINTS, CONTRADICTION, VALIDITY, INTEGRITY, STATUS, COMMAND, IMU, BODY, FAULTS, DIAGNOSTICS,
    ROSOUT, PARAMETER_EVENTS,
)  # fmt: skip
"""All topics, in the order of the ICD's table."""

SENT_BY: dict[str, tuple[str, ...]] = {
    TRUTH.name: ("motion", "robots"),
    TRUTH_JOINTS.name: ("motion",),
    REFERENCE.name: ("motion",),
    SUN.name: ("motion", "lamp"),
    TF_STATIC.name: ("sensor",),
    TF.name: ("motion", "estimator"),
    CLOCK.name: ("motion", "replay"),
    **dict.fromkeys((DEPTH.name, AMPLITUDE.name, DEPTH_SIGMA.name), ("camera",)),
    **dict.fromkeys((CAMERA_INFO.name, PHASE.name, PMD_INFO.name), ("camera",)),
    **dict.fromkeys((POINTS.name, LIDAR_INFO.name), ("LIDAR",)),
    **dict.fromkeys((ESTIMATE.name, ESTIMATE_POSE.name, ESTIMATE_FRAME.name), ("estimator",)),
    **dict.fromkeys((ESTIMATE_JOINTS.name, CONTRADICTION.name, VALIDITY.name), ("estimator",)),
    **dict.fromkeys((INTEGRITY.name, STATUS.name), ("estimator",)),
    COMMAND.name: ("guidance", "motion"),
    IMU.name: ("chaser", "motion"),
    BODY.name: ("robots", "motion"),
    FAULTS.name: ("emulator", "proxy", "supervisor", "logger"),
    **dict.fromkeys((DIAGNOSTICS.name, ROSOUT.name, PARAMETER_EVENTS.name), ("service",)),
}  # fmt: skip
"""Publishers of each topic, by its name: the column "from" of the ICD's table."""

OF_MANY: tuple[Topic, ...] = (TF, FAULTS, DIAGNOSTICS, ROSOUT, PARAMETER_EVENTS)
"""Topics that several services publish at the same time, each its own content."""

ESTIMATES: tuple[Topic, ...] = tuple(topic for topic in TOPICS if topic.name.startswith("estimate/"))
"""Topics of an estimator; a second estimator has its own prefix in place of ``estimate``."""

ABSOLUTE_TOPICS: tuple[Topic, ...] = tuple(topic for topic in TOPICS if topic.absolute)
"""Topics that stand outside of all namespaces."""

TRUTH_TOPICS: tuple[Topic, ...] = (TRUTH, TRUTH_JOINTS, REFERENCE, TF)
"""Topics that an estimator must never read: the facility's truth in any form."""

CHASER, TARGET, TARGET_ESTIMATE = "chaser", "target", "target_estimate"
"""Frame names (ICD section 1)."""


def optical_frame(sensor: str) -> str:
    """Return the optical frame of a camera."""
    return f"{sensor}_optical"


@dataclass(frozen=True)
class Namespace:
    """Part of the key space that a facility uses."""

    domain: int = 0
    prefix: str = ""
    """ROS namespace without slashes at its ends; may be empty."""

    @property
    def root(self) -> str:
        """First part of all keys, ``<domain>/<namespace>``, without trailing slash."""
        return f"{self.domain}/{self.prefix}" if self.prefix else str(self.domain)

    def key(self, topic: Endpoint) -> str:
        """Return the key on which a topic is published, or a service called."""
        return f"{self._place(topic)}/{topic.wire_type}/{type_hash(topic.type)}"

    def selector(self, topic: Endpoint) -> str:
        """Return the key expression by which a topic is subscribed, or a service offered: any type hash."""
        return f"{self._place(topic)}/{topic.wire_type}/*"

    def _place(self, topic: Endpoint) -> str:
        return f"{self.domain if topic.absolute else self.root}/{topic.name}"

    def ros_name(self, topic: Endpoint) -> str:
        """Return the name that ROS 2 shows: ``/lab/logger/split``."""
        return f"/{topic.name}" if topic.absolute or not self.prefix else f"/{self.prefix}/{topic.name}"

    def control(self, instance: str, verb: str, role: str = "") -> str:
        """Return the key of a control-plane query (ICD section 4).

        In the profile ``secure`` it ends with the name of who asks, ``role``; a service serves ``*`` there.
        """
        return f"{self.root}/rpod/{instance}/{verb}" + (f"/by/{role}" if role else "")

    def topic_of(self, key: str) -> str:
        """Return the topic's name of a data-plane key."""
        return key.removeprefix(f"{self.root}/").rsplit("/", 2)[0]

    def topic_at(self, key: str) -> Topic:
        """Return the topic of any key, without a type if the key or its type is unknown."""
        for topic in ABSOLUTE_TOPICS:
            if key.startswith(f"{self._place(topic)}/{topic.wire_type}/"):
                return topic
        relative = key.removeprefix(f"{self.root}/")
        *name, wire_type, _ = relative.rsplit("/", 2) if relative.count("/") > 1 else ("", "")
        if name and is_wire_type(wire_type) and is_known(type_of_wire(wire_type)):
            return Topic(name[0], type_of_wire(wire_type))
        return Topic(relative, "")


_LATCHED = frozenset(topic.name for topic in TOPICS if topic.latched)


def is_latched(name: str) -> bool:
    """Return whether a topic is latched according to the ICD."""
    kind = name.split("/", 1)[-1]
    return not _LATCHED.isdisjoint((name, f"<camera>/{kind}", f"<lidar>/{kind}"))


def is_wire_type(text: str) -> bool:
    """Return whether a text is a message's type as DDS names it; anybody may write a key or a token."""
    package, *rest = text.split("::")
    return bool(package) and rest[:-1] == ["msg", "dds_"] and rest[-1].endswith("_")


def wire_type(type_name: str) -> str:
    """Return a ROS 2 type as DDS names it: ``sensor_msgs::msg::dds_::Image_``."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


@cache
def type_of_wire(wire_type: str) -> str:
    """Return the ROS 2 type of a DDS type: the inverse of ``wire_type``."""
    package, kind, _, name = wire_type.split("::")
    return f"{package}/{kind}/{name.removesuffix('_')}"
