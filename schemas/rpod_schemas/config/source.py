"""How the driver of another party publishes a sensor: its topics, stamps and units.

A sensor that keeps to the ICD needs none of it. Files for well-known drivers are in ``deploy/sensors``.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.bounds import SCAN_TIME_S
from rpod_schemas.config.base import NAMESPACE, TOPIC, Config, Positive, in_place, read_document
from rpod_schemas.poses import chained, make_pose
from rpod_schemas.topics import COMPRESSED_IMAGE, Topic

_NANOSECONDS = 1_000_000_000
_MIDDLE = {"start": 0.5, "middle": 0.0, "end": -0.5}
"""Time from the stamp to the middle of exposure or scan, over its duration."""
_LATEST_S = 2.0**31
"""Latest stamp of a message, s (ICD section 1): no two clocks are farther apart."""
_Span = Annotated[float, Field(ge=0.0, le=SCAN_TIME_S.high, allow_inf_nan=False)]
"""Time that is not longer than the longest scan, s."""
_TRANSPORTED = {"compressed", "compressedDepth"}
"""Last parts of the topics of image_transport whose messages are compressed images."""

FORWARD_BORESIGHT = make_pose(rotation=Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
"""Axes x right, y down, z along the boresight in axes x forward, y left, z up."""


class SourceConfig(Config):
    """How a driver publishes a sensor, where it does not keep to the ICD."""

    topics: dict[str, Annotated[str, Field(pattern=TOPIC)]] = Field(default_factory=dict)
    """Topics of the sensor's parts (``depth``, ``camera_info``, ``amplitude``; ``points``), under
    ``namespace``, or with a leading slash under the bus's own. Where any is given, parts that are not given
    are not listened to. A topic that ends in ``/compressed`` or ``/compressedDepth`` brings compressed
    images."""
    namespace: str = Field(default="", pattern=NAMESPACE)
    """First part of these topics: namespace and name of the driver's node, without slashes at its ends."""
    stamp: Literal["start", "middle", "end"] = "middle"
    """Instant of the exposure or scan that the stamps are of."""
    duration_s: _Span = 0.0
    """Duration of an exposure or scan, s. Set it where ``stamp`` is ``start`` or ``end``; stamps are moved by
    half of it."""
    clock_offset_s: float = Field(default=0.0, ge=-_LATEST_S, le=_LATEST_S, allow_inf_nan=False)
    """Time by which the sensor's clock is ahead, s; it is subtracted from the stamps. 37 for a clock that
    keeps TAI."""
    arrives_within_s: Positive = 0.1
    """Time from the end of an exposure or scan within which its frame arrives: read-out, driver and link
    together, s. Where all frames take longer, the estimator says that stamps may be early. Raise it for a
    driver that is known to be slow."""
    pair_within_s: _Span = 0.001
    """Largest difference between the stamps of a frame's parts, s; it never counts beyond half the time
    between two frames."""
    depth: Literal["z", "radial"] = "z"
    """Meaning of a depth image's pixels: distance along the boresight, or along the pixel's own ray."""
    depth_unit_m: Positive | None = None
    """Length of one unit of a depth image, m. If left out, ``32FC1`` is in metres and ``16UC1`` in
    millimetres, as ROS has it (REP 118)."""
    axes: Literal["boresight", "forward"] = "boresight"
    """Axes of the sensor's frame and points: x right, y down, z along the boresight; or x forward, y left, z
    up (REP 103), as scanners with a turning head have them. The mount is that of the frame as it is. Images
    have no such axes: of a camera this changes the meaning of the mount alone."""
    saturated_amplitude: Positive | None = None
    """Amplitude from which a pixel is saturated. If left out, it is recognised: by the encoding's largest
    value, and by a frame's largest value where many pixels have it."""

    @property
    def to_middle_s(self) -> float:
        """Time from a stamp to the middle of its exposure or scan, s, by the sensor's clock."""
        return _MIDDLE[self.stamp] * self.duration_s

    @property
    def correction_ns(self) -> int:
        """Difference between the middle of exposure or scan, in UTC, and the stamp, ns."""
        return round((self.to_middle_s - self.clock_offset_s) * _NANOSECONDS)

    def boresight_mount(self, T_chaser_sensor: RigidTransform) -> RigidTransform:
        """Return the mount of the sensor's axes x right, y down, z along the boresight."""
        return chained(T_chaser_sensor, FORWARD_BORESIGHT) if self.axes == "forward" else T_chaser_sensor

    def topic(self, part: str, default: Topic) -> Topic | None:
        """Return the topic of a part of the sensor's frames; None if the driver does not send this part.

        Args:
            part: name of the part in the sensor kind.
            default: topic that the ICD gives the part.
        """
        if not self.topics:
            return default
        name = self.topics.get(part)
        if name is None:
            return None
        whole = name.lstrip("/") if name.startswith("/") or not self.namespace else f"{self.namespace}/{name}"
        compressed = whole.rsplit("/", 1)[-1] in _TRANSPORTED
        return Topic(whole, COMPRESSED_IMAGE if compressed else default.type)

    @model_validator(mode="after")
    def _the_middle_is_known(self) -> Self:
        if self.stamp != "middle" and not self.duration_s:
            raise ValueError(
                f"stamp is {self.stamp!r}, needs duration_s, the exposure or scan time, to find its middle"
            )
        return self


def _read(value: Any) -> Any:
    """Return the document of a source: a file's, or one whose ``preset`` names a file, with changes to it."""
    if isinstance(value, Mapping) and "preset" in value:
        changes = {name: field for name, field in value.items() if name != "preset"}
        document = _document(value["preset"])
        given, changed = document.get("topics"), changes.get("topics")
        if isinstance(given, Mapping) and isinstance(changed, Mapping):
            changes["topics"] = {**given, **changed}
        return {**document, **changes}
    return in_place(value, read_document)


def _document(file: Any) -> dict[str, Any]:
    if not isinstance(file, str | Path):
        raise ValueError(f"preset is {file!r}, needs the path of a file, as deploy/sensors/realsense.yaml")
    document: dict[str, Any] = in_place(file, read_document)
    return document


Source = Annotated[SourceConfig, BeforeValidator(_read)]
"""A source, written inline, as the path of a file, or as ``preset: <path>`` with fields that change it."""
