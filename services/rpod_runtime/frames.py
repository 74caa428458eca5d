"""The port that decodes and checks the parts of a complete frame.

A reader reads the messages of one sensor and keeps the sensor's info. A sensor kind names its reader; the
readers of the PMD camera and the LIDAR are in ``readers/``.
"""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar, runtime_checkable

from rpod_runtime.assembler import Assembled, Assembler
from rpod_runtime.delivery.inbox import Received
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import ConfigurationError, MessageRejectedError, Reason
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.registry import resolve
from rpod_schemas.sensors import SensorKind
from rpod_schemas.types import SensorFrame

ReadT = TypeVar("ReadT")

ICD = SourceConfig()
"""The source of a sensor that keeps to the interface control document."""


@runtime_checkable
class SensorReader(Protocol):
    """Reads the messages of one sensor. It is created as ``(source)``, how the sensor's driver publishes.

    A reader inherits from this class, for the properties that it has no use for.
    """

    @property
    def newest_info(self) -> Any:
        """Info that describes the sensor; None as long as there is none."""
        return None

    @property
    def stated_info(self) -> Any:
        """The part of ``newest_info`` that the sensor has published, and that must not change in a track."""
        return self.newest_info

    @property
    def inconsistency(self) -> str:
        """How the messages of the sensor contradict each other; empty if they do not."""
        return ""

    @property
    def hint(self) -> str:
        """Fault in the newest frames that may be why they are refused; empty if there is none."""
        return ""

    def assume(self, info: Any) -> None:
        """Store the info that the configuration states; it counts until the sensor publishes its own.

        Args:
            info: ``configured_info`` of the sensor's configuration; None if it states none.
        """

    def learn(self, message: Any) -> None:
        """Store the sensor's info, a decoded message. Raises ``MessageRejectedError``."""
        ...

    def read(self, frame: Assembled[Received]) -> SensorFrame:
        """Return a frame. Raises ``PartRejectedError``."""
        ...


def open_reader(kind: SensorKind, source: SourceConfig = ICD) -> SensorReader:
    """Return a new reader of a kind. Raises ``ConfigurationError``: it lacks a part of ``SensorReader``."""
    reader = resolve(kind.reader)(source)
    if not isinstance(reader, SensorReader):
        reason = f"{kind.reader} is no SensorReader; let it inherit from rpod_runtime.frames.SensorReader"
        raise ConfigurationError(kind.name, "reader", reason)
    return reader


def assembler_of(kind: SensorKind, source: SourceConfig = ICD) -> Assembler[Any]:
    """Return an assembler of the frames of a kind (ICD section 2)."""
    optional = frozenset(name for name in kind.optional if source.topic(name, kind.leading) is not None)
    within_ns = round(source.pair_within_s * NANOSECONDS)
    return Assembler(kind.required, optional, kind.lasting, kind.leading_part, within_ns)


class PartRejectedError(MessageRejectedError):
    """A part of a frame cannot be used; ``topic`` is the topic on which it came."""

    def __init__(self, received: Received, rejection: MessageRejectedError) -> None:
        super().__init__(rejection.reason, rejection.text)
        self.topic = received.topic.name


def read_part(received: Received, read: Callable[[Any], ReadT]) -> ReadT:
    """Return the result of ``read`` for the decoded part. Raises ``PartRejectedError`` if it is refused."""
    try:
        return read(received.decode())
    except MessageRejectedError as error:
        raise PartRejectedError(received, error) from error


_OTHER_SIZE = {
    "depth": "let its driver send the camera_info of the depth image, as it is scaled or cropped",
    "amplitude": (
        "let its driver send one of the size of the depth image, pixel for pixel, or leave amplitude out of "
        "source.topics"
    ),
}
"""Remedy for an image of another size."""


def sized(image: Any, size: tuple[int, int], name: str = "") -> Any:
    """Return the image if its shape is ``size``, (height, width); else raise ``MessageRejectedError``.

    ``name`` is that of the image in the message, "depth" or "amplitude".
    """
    if image.shape != size:
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"{f'the {name} image' if name else 'image'} is {image.shape[1]} x {image.shape[0]} pixels, "
            f"camera_info says {size[1]} x {size[0]}; {_OTHER_SIZE.get(name, 'correct the driver')}",
        )
    return image
