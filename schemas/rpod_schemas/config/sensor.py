"""Fields that every sensor's and every method's configuration has, and the choice of a model by ``kind``."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self, TypeVar

from pydantic import (
    AfterValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    field_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema
from scipy.spatial.transform import RigidTransform

from rpod_schemas.config.base import Config, Name, NonNegative, Positive
from rpod_schemas.config.mount_calibration import Mount, MountPose
from rpod_schemas.config.source import Source, SourceConfig
from rpod_schemas.errors import SchemaError
from rpod_schemas.poses import Pose, make_pose
from rpod_schemas.types import SensorInfo


class Kinded(Config):
    """A configuration that is chosen by its ``kind``, whose default is the only value that it takes."""

    kind: str
    """Name of the sensor kind or method in the registry."""

    @field_validator("kind")
    @classmethod
    def _is_its_own(cls, kind: str) -> str:
        own = cls.model_fields["kind"].default
        if kind != own:
            raise ValueError(f"is {kind!r}, {cls.__name__} needs {own!r}")
        return kind


class EmulatedSensor(Kinded):
    """A sensor to emulate: name, timing and mount; a kind adds its own fields."""

    name: Name
    """Name of the sensor: prefix of its topics."""
    rate_hz: Positive
    """Number of frames per second."""
    T_chaser_sensor: MountPose = Field(default_factory=make_pose)
    """Mount: pose of the sensor's (optical) frame in the chaser."""

    stated_T_chaser_sensor: Pose | None = None
    """Mount that the sensor publishes. Set it to emulate one that is calibrated wrongly; if left out, it is
    the true one."""

    @property
    def published_mount(self) -> RigidTransform:
        """Mount that the sensor publishes."""
        stated = self.stated_T_chaser_sensor
        return self.T_chaser_sensor if stated is None else stated

    @property
    def latency_s(self) -> float:
        """Time from the stamp, the middle of exposure or scan, to the hand-over, s."""
        raise NotImplementedError

    def pose_times_s(self) -> tuple[float, ...]:
        """Return the times at which a frame needs the target's pose, offsets from the stamp, s."""
        return (0.0,)


def _rising(range_m: tuple[float, float]) -> tuple[float, float]:
    if range_m[0] >= range_m[1]:
        raise ValueError(f"is {range_m[0]:g} to {range_m[1]:g} m, needs to rise: least first")
    return range_m


Range = Annotated[tuple[NonNegative, Positive], AfterValidator(_rising)]
"""Least and greatest distance, m."""


class AlertLimit(Config):
    """Error beyond which an estimate is of no use, as the mission has it.

    A prediction without measurements is published while the standard deviation in its worst direction is
    below it; beyond it the target is LOST.
    """

    attitude_deg: Positive = 3.0
    """Attitude, deg. Set it to what guidance and capture tolerate."""
    position_m: Positive | None = None
    """Position, m. Set it where the tolerance does not depend on the range; then ``range_share`` does not
    count."""
    range_share: Positive = 0.01
    """Position as a share of the range to the target's origin. Set it where the tolerance grows with the
    range, and leave ``position_m`` out."""

    def position_limit_m(self, range_m: float) -> float:
        """Return the limit of the position at a range, m."""
        return self.range_share * range_m if self.position_m is None else self.position_m


RANGE_OFFSET_SIGMA_M = 0.03
"""Standard deviation of the offset of a scanner's ranges: the accuracy in their data sheets, 3 cm."""


class SensorInput(Kinded):
    """A sensor that the estimator uses; a kind adds what its methods need."""

    name: Name
    """Name of the sensor: the first part of its topics."""
    T_chaser_sensor: Mount | None = None
    """Mount of the sensor, or the file of ``rpod calibrate mount``. Set it if tf_static does not give the
    mount; where both give it, they must agree."""
    range_m: Range | None = None
    """Least and greatest distance to the target's origin at which the sensor is used, m. Set it where the
    sensor's poses are worse than another sensor's beyond it: a camera's frames of a target that is a few
    pixels wide may agree with a wrong attitude. If left out, each pose that the method accepts is used."""
    alert_limit: AlertLimit = AlertLimit()
    """Error beyond which an estimate by this sensor is of no use."""
    source: Source = SourceConfig()
    """How the driver publishes, if it does not keep to the ICD: a file of ``deploy/sensors`` or of your own,
    ``preset: FILE`` with changes to it, or all of it inline."""

    @property
    def range_offset_sigma_m(self) -> float:
        """Standard deviation of the offset that all distances of the sensor may share, m."""
        return RANGE_OFFSET_SIGMA_M

    @property
    def configured_info(self) -> SensorInfo | None:
        """Info of the sensor, as far as this configuration states it; None if it states none."""
        return None

    def informed_by(self, emulated: EmulatedSensor) -> Self:  # noqa: ARG002 - what a kind may want to know
        """Return this input with the data that the sensor will publish of itself."""
        return self


SensorT = TypeVar("SensorT", bound=EmulatedSensor | SensorInput)


def _distinct(sensors: tuple[SensorT, ...]) -> tuple[SensorT, ...]:
    names = [sensor.name for sensor in sensors]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"two have the name {twice[0]!r}; give each a 'name' of its own")
    return sensors


DISTINCT = AfterValidator(_distinct)
"""Annotation of sensors of which no two may have the same name, since it begins their topics."""


class MethodConfig(Kinded):
    """Parameters of a method."""


@dataclass(frozen=True)
class Registered:
    """Annotation of a field whose model is looked up by the document's ``kind``.

    Args:
        model_of: returns the model of a kind; raises ``SchemaError`` for one that is not known.
        kinds: returns the kinds that are known.
        default: kind for a document that names none; if empty, the document must name one.
    """

    model_of: Callable[[str], type[Kinded]]
    kinds: Callable[[], tuple[str, ...]]
    default: str = ""

    def models(self) -> list[type[Kinded]]:
        """Return the models of all kinds that are known."""
        return [self.model_of(kind) for kind in self.kinds()]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return a schema that validates with the registered model and dumps the value as it is."""
        return core_schema.no_info_plain_validator_function(self._validated)

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the JSON schema of all installed models."""
        models = [handler(model.__pydantic_core_schema__) for model in self.models()]
        return {"oneOf": models, "discriminator": {"propertyName": "kind"}}

    def _validated(self, value: Any) -> Kinded:
        kind = value.kind if isinstance(value, Kinded) else self._kind_of(value)
        try:
            model = self.model_of(kind)
        except SchemaError as error:
            raise _wrong_kind(kind, str(error)) from error
        if isinstance(value, model):
            return value
        return model.model_validate(dict(value) if isinstance(value, Kinded) else value)

    def _kind_of(self, document: Any) -> str:
        if not isinstance(document, Mapping):
            raise PydanticCustomError("mapping", "needs named fields, kind among them")
        kind = document.get("kind", self.default)
        if not isinstance(kind, str) or not kind:
            raise _wrong_kind(kind, f"is missing, known are {', '.join(self.kinds())}")
        return kind


def _wrong_kind(value: Any, text: str) -> ValidationError:
    error = PydanticCustomError("kind", "{text}", {"text": text})
    return ValidationError.from_exception_data(
        "kind", [InitErrorDetails(type=error, loc=("kind",), input=value)]
    )
