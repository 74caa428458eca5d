"""What every sensor's and method's configuration has, and how ``kind`` chooses among the installed ones."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError, field_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from rpod_schemas.config.base import Config, Name, Positive
from rpod_schemas.errors import SchemaError
from rpod_schemas.poses import Pose, make_pose


class Kinded(Config):
    """A configuration that is chosen by its ``kind``, whose default is the only value that it takes."""

    kind: str
    """Under which the registry knows it."""

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
    """Prefix of its topics."""
    rate_hz: Positive
    """Frames per second."""
    T_chaser_sensor: Pose = Field(default_factory=make_pose)
    """Mount: pose of the sensor's (optical) frame in the chaser."""

    @property
    def latency_s(self) -> float:
        """From the stamp, the middle of the exposure or scan, to the frame's hand-over."""
        raise NotImplementedError

    def pose_times_s(self) -> tuple[float, ...]:
        """Return when the target's pose is needed to make a frame, offsets from the stamp."""
        return (0.0,)


class SensorInput(Kinded):
    """A sensor that the estimator listens to; a kind adds what its methods need."""

    name: Name
    """Name of the sensor: the first part of its topics."""
    T_chaser_sensor: Pose | None = None
    """Mount, where tf_static does not tell."""

    def informed_by(self, emulated: EmulatedSensor) -> Self:  # noqa: ARG002 - what a kind may want to know
        """Return this input with what the sensor will say of itself: methods are ready before it does."""
        return self


class MethodConfig(Kinded):
    """Parameters of a method."""


@dataclass(frozen=True)
class Registered:
    """Annotation of a field whose model is looked up by the document's ``kind``.

    Args:
        model_of: returns the model of a kind; raises ``SchemaError`` for one that is not known.
        kinds: returns the kinds that are known.
        default: the kind of a document that names none; where empty, it must name one.
    """

    model_of: Callable[[str], type[Kinded]]
    kinds: Callable[[], tuple[str, ...]]
    default: str = ""

    def models(self) -> list[type[Kinded]]:
        """Return the models of all kinds that are known."""
        return [self.model_of(kind) for kind in self.kinds()]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate with the registered model; dump as what it is."""
        return core_schema.no_info_plain_validator_function(self._validated)

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe all models that are installed."""
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
