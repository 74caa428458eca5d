"""Sensor kinds and methods: names, topics, models, and references to modules that take long to import."""

from dataclasses import dataclass
from typing import Any, Literal

from rpod_schemas.config.sensor import EmulatedSensor, MethodConfig, SensorInput
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.registry import resolve
from rpod_schemas.topics import Topic
from rpod_schemas.types import SensorFrame, SensorInfo

Role = Literal["acquisition", "tracking"]
"""Role of a method: to find the target without a guess, or to track it from a predicted pose."""


@dataclass(frozen=True)
class Part:
    """One message of a frame."""

    topic: Topic
    """Topic of the message, as ``<camera>/depth/image_raw``."""
    required: bool = True
    """Whether a frame is incomplete without it."""
    lasting: bool = False
    """Whether a message is valid until another one comes, so that not every frame needs its own."""


@dataclass(frozen=True)
class SensorKind:
    """A kind of sensor, with everything in which one kind differs from another.

    The references ``module:attribute`` are imported by the process that needs them, so that a logger or a
    camera's computer needs no compiled methods and no meshes.
    """

    name: str
    """Name of the kind in configurations, and of its entry point in ``rpod.sensors``."""
    title: str
    """Title in texts, as in "frames of a PMD camera"."""
    parts: dict[str, Part]
    """Messages of a frame by name; the first is the leading one, without which there is no frame."""
    emulated: type[EmulatedSensor]
    """Configuration of the emulated sensor."""
    heard: type[SensorInput]
    """Configuration of the sensor in the estimator: its methods and their data."""
    reader: str
    """Reference to an ``rpod_runtime.frames.SensorReader``, created with a sensor's ``SourceConfig``: from
    the messages of a frame to the methods' input."""
    publisher: str
    """Reference to an ``rpod_runtime.sensors.SensorPublisher``: from frames to messages, for drivers and the
    emulator."""
    emulator: str
    """Reference to an ``rpod_emulator.channels.Channel``: from truth to frames."""
    methods: str
    """Reference to the ``rpod_pose.ports.KindMethods`` that build and warm up the methods."""
    info: Topic | None = None
    """Latched message in which the sensor describes itself."""
    frame: type[SensorFrame] | None = None
    """Model of a frame; without it, a driver in a process of its own (``process``) cannot bring the kind."""
    info_model: type[SensorInfo] | None = None
    """Model of the content of ``info``, for such a driver."""
    checks: str = ""
    """Reference to an ``rpod_driver.check.kinds.KindChecks``: lines of ``rpod driver check`` for this kind
    alone; without it, only what holds for any sensor is checked."""
    reduced_rate: str = ""
    """Reference to the publisher of a stream of reduced rate, created as ``(node, name, config)`` with a
    ``ReducedRateConfig``; without it, the kind has no such stream."""
    extras: tuple[Topic, ...] = ()
    """Topics that are recorded but belong to no frame."""

    @property
    def leading_part(self) -> str:
        """Name of the leading part."""
        return next(iter(self.parts))

    @property
    def leading(self) -> Topic:
        """Topic of the leading part."""
        return self.parts[self.leading_part].topic

    @property
    def required(self) -> frozenset[str]:
        """Names of the parts that each frame must have of its own."""
        return frozenset(name for name, part in self.parts.items() if part.required and not part.lasting)

    @property
    def lasting(self) -> frozenset[str]:
        """Names of the parts that are valid until another one comes."""
        return frozenset(name for name, part in self.parts.items() if part.lasting)

    @property
    def optional(self) -> frozenset[str]:
        """Names of the parts that a frame may lack."""
        return frozenset(self.parts) - self.required - self.lasting

    def part_topics(self, sensor: str, source: SourceConfig) -> dict[str, Topic]:
        """Return the topics of the parts that a sensor's driver sends, by the part's name.

        Raises:
            ConfigurationError: the source names a part that the kind does not have, lacks one without which
                there is no frame, or has one topic for two parts.
        """
        found = {name: source.topic(name, part.topic.of(sensor)) for name, part in self.parts.items()}
        wrong = [f"{name!r} is no part of a {self.title}" for name in source.topics if name not in found]
        wrong += [f"{name!r} is missing" for name in self.required | self.lasting if found[name] is None]
        if wrong:
            known = ", ".join(f"{name}{' (optional)' * (name in self.optional)}" for name in found)
            raise ConfigurationError(sensor, "source.topics", f"{wrong[0]}; name the topics of {known}")
        topics = {name: topic for name, topic in found.items() if topic is not None}
        parts: dict[str, str] = {}
        for name, topic in topics.items():
            if (other := parts.setdefault(topic.name, name)) != name:
                reason = f"{other} and {name} have the topic {topic.name!r}; give each part its own"
                raise ConfigurationError(sensor, "source.topics", reason)
        return topics

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All topics that such a sensor publishes, except ``tf_static``."""
        info = () if self.info is None else (self.info,)
        return (*(part.topic for part in self.parts.values()), *info, *self.extras)


@dataclass(frozen=True)
class Method:
    """A way to acquire or to track the target with a sensor kind."""

    sensor: str
    """Name of the sensor kind."""
    role: Role
    """Role of the method."""
    config: type[MethodConfig]
    """Its parameters; their ``kind`` is the method's name."""
    build: str
    """Reference to ``(config, rpod_pose.ports.Task) -> Acquirer`` or ``Tracker``."""

    @property
    def name(self) -> str:
        """Name in configurations; its entry point in ``rpod.methods`` is ``<sensor>.<name>``."""
        return str(self.config.model_fields["kind"].default)

    def built(self, config: MethodConfig, task: Any) -> Any:
        """Return the method, after importing its module."""
        return resolve(self.build)(config, task)
