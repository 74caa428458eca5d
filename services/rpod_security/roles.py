"""Rights of each role, from the interface control document: what it may publish, read, serve and ask.

The publishers of a topic are the column "from" of the ICD's table (``rpod_schemas.topics.SENT_BY``). Its
readers, and the queries between roles, stand here.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rpod_schemas.config.facility.rights import SensorGrant
from rpod_schemas.sensors import sensor_kind, sensor_kinds
from rpod_schemas.topics import (
    BODY,
    CLOCK,
    COMMAND,
    DIAGNOSTICS,
    ESTIMATES,
    IMU,
    PARAMETER_EVENTS,
    REFERENCE,
    ROSOUT,
    SENT_BY,
    STATUS,
    SUN,
    TF,
    TF_STATIC,
    TOPICS,
    TRUTH,
    TRUTH_TOPICS,
    Topic,
)

ROUTER, LINK = "router", "link"
ANY = "*"


@dataclass(frozen=True)
class Role:
    """Rights of a role, beside those that the topic table and its sensors give it."""

    title: str
    """Description for the operator."""
    sends_as: tuple[str, ...] = ()
    """Names of this role in the column "from" of the ICD's table."""
    reads: tuple[Topic, ...] = ()
    """Topics that it reads."""
    reads_estimates: bool = False
    reads_sensors: bool = False
    watches: bool = False
    """Whether it watches which publishers there are."""
    is_sole: bool = False
    """Whether it asks, before it starts, for another service of its name."""
    sole_topics: tuple[Topic, ...] = ()
    """Topics of which it watches whether others publish them."""
    serves: tuple[str, ...] = ()
    """Verbs that it serves beside those of all services."""
    asks: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Verbs that it asks, by the role that serves them; ``*`` stands for every role or verb."""


_STATUS_OF_ALL = {ANY: ("status",)}
_EVERYTHING = tuple(topic for topic in TOPICS if not topic.name.startswith("<") and topic not in ESTIMATES)

ROLES: dict[str, Role] = {
    LINK: Role("joins a router to that of another host; it may do what the members there may"),
    ROUTER: Role("the bus; its certificate serves no client"),
    "motion": Role(
        "publishes the truth, and the time in lockstep",
        sends_as=("motion",),
        reads=(STATUS,),
        is_sole=True,
        sole_topics=(TRUTH,),
        serves=("start",),
        asks=dict.fromkeys(("estimator", "logger", "emulator"), ("status",)),
    ),
    "robots": Role("drives robots, and publishes the truth as achieved", ("robots",), reads=(REFERENCE,)),
    "lamp": Role("drives the lamp, and publishes the sun", ("lamp",)),
    "emulator": Role(
        "emulates sensors",
        sends_as=("sensor", "emulator"),
        reads=(TRUTH, SUN, CLOCK),
        is_sole=True,
        serves=("start", "fault"),
    ),
    "driver": Role(
        "publishes one sensor, or several",
        sends_as=("sensor",),
        reads=(CLOCK,),
        serves=("settings", "trigger"),
    ),
    "estimator": Role(
        "estimates poses; it reads nothing of the truth",
        sends_as=("estimator",),
        reads=(TF_STATIC, IMU, COMMAND, BODY, DIAGNOSTICS, CLOCK),
        reads_sensors=True,
        watches=True,
        is_sole=True,
        serves=("reset",),
    ),
    "logger": Role(
        "records everything",
        sends_as=("logger",),
        reads=_EVERYTHING,
        reads_estimates=True,
        reads_sensors=True,
        watches=True,
        is_sole=True,
        serves=("start", "stop", "split", "fault"),
        asks=_STATUS_OF_ALL,
    ),
    "view": Role(
        "shows everything",
        reads=(TRUTH, TF, TF_STATIC, DIAGNOSTICS, CLOCK),
        reads_estimates=True,
        reads_sensors=True,
        watches=True,
        asks=_STATUS_OF_ALL,
    ),
    "proxy": Role("makes links faulty, and tells which", sends_as=("proxy",), serves=("fault",)),
    "operator": Role(
        "starts, resets and ends services, also as the supervisor of a run",
        sends_as=("supervisor",),
        reads=(TF, DIAGNOSTICS, CLOCK),
        reads_estimates=True,
        serves=("fault",),
        asks={ANY: (ANY,)},
    ),
    "replay": Role(
        "plays a log onto the bus in place of sensors, truth and time", ("replay", "motion", "sensor")
    ),
    "guidance": Role(
        "commands the chaser by the estimates",
        sends_as=("guidance",),
        reads=(DIAGNOSTICS, CLOCK),
        reads_estimates=True,
    ),
    "chaser": Role("publishes the chaser's inertial measurements", ("chaser",)),
}  # fmt: skip
"""Roles by name."""

_VERBS = "status", "shutdown", "reload"
_OF_ALL = DIAGNOSTICS, ROSOUT, PARAMETER_EVENTS


@dataclass(frozen=True)
class Member:
    """Somebody on the bus, with a certificate of this name."""

    name: str
    role: str
    sensors: tuple[SensorGrant, ...] = ()
    """Sensors that it publishes or reads."""
    prefix: str = "estimate"
    """First part of the topics of the estimates that it publishes."""
    extra: tuple[str, ...] = ()
    """Key expressions that it reads beside the ICD's topics."""
    prefixes: tuple[str, ...] = ("estimate",)
    """First parts of the topics of all estimates in the facility."""

    @property
    def publishes(self) -> tuple[Topic, ...]:
        """Topics that it may publish; ``*`` stands for a part of the name."""
        mine = ROLES[self.role].sends_as
        senders = {name for name in mine if name != "sensor"}
        topics = [topic for topic in TOPICS if senders & set(SENT_BY[topic.name])]
        found = [topic.under(self.prefix) if topic in ESTIMATES else topic for topic in topics]
        if "sensor" in mine:
            found += [TF_STATIC, *self._of_sensors()]
        return tuple(dict.fromkeys(topic.at(ANY) for topic in (*found, *_OF_ALL)))

    @property
    def reads(self) -> tuple[Topic, ...]:
        """Topics that it may read; ``*`` stands for a part of the name."""
        role = ROLES[self.role]
        estimates = ESTIMATES if role.reads_estimates else tuple(set(role.reads) & {STATUS})
        # ``*/odometry`` is a topic of the truth too
        prefixes = (ANY,) if set(TRUTH_TOPICS) <= set(role.reads) else self.prefixes
        found = [topic for topic in role.reads if topic != STATUS]
        found += [topic.under(prefix) for topic in estimates for prefix in prefixes]
        if role.reads_sensors:
            found += self._of_sensors()
        return tuple(dict.fromkeys(topic.at(ANY) for topic in found))

    def _of_sensors(self) -> list[Topic]:
        """Return the topics of the configured sensors; those of all installed kinds if none is configured."""
        if self.sensors:
            return [topic for sensor in self.sensors for topic in topics_of(sensor)]
        return [topic.of(ANY) for kind in sensor_kinds() for topic in kind.topics]

    @property
    def serves(self) -> tuple[str, ...]:
        """Verbs of the control plane that it may serve."""
        return (*_VERBS, *ROLES[self.role].serves)

    @property
    def asks_all(self) -> bool:
        """Whether it may ask all services at once for their status."""
        return bool({"status", ANY} & set(ROLES[self.role].asks.get(ANY, ())))

    def asks(self, other: "Member") -> tuple[str, ...]:
        """Return the verbs of another member that it may ask."""
        asked = ROLES[self.role].asks
        verbs = asked.get(other.role, asked.get(ANY, ()))
        return other.serves if ANY in verbs else tuple(verb for verb in verbs if verb in other.serves)


def topics_of(sensor: SensorGrant) -> tuple[Topic, ...]:
    """Return the topics of a sensor, as its driver publishes them."""
    kind = sensor_kind(sensor.kind)
    parts = {part.topic for part in kind.parts.values()}
    others = (topic.of(sensor.name) for topic in kind.topics if topic not in parts)
    return (*kind.part_topics(sensor.name, sensor.source).values(), *others)


def needs_sensors(role: str) -> bool:
    """Return whether a role publishes sensors, so that its configuration has to name them."""
    return "sensor" in ROLES[role].sends_as and role != "replay"
