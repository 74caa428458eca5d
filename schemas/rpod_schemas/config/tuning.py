"""Tuning: parameters of a method that are no part of the promise, each with its provenance beside it.

A public field of a configuration stays from version to version and says when to change it. A field of a
``tuning`` model may change its name, its value or vanish with any version. ``Provenance`` says where its
default comes from. Values of the source ``campaign`` are those that the command writes which derives limits
from a population of targets and worlds; its note names the campaign, the seeds, the quantile and the margin.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from rpod_schemas.config.base import Config

Origin = Literal["paper", "physics", "campaign", "numerics", "hand, mock-up"]
"""Where a value comes from.

``paper``: a publication states it. ``physics``: it follows from a law, a definition or the statistics of a
distribution. ``campaign``: a campaign over many targets derived it. ``numerics``: it trades time against the
convergence or the resolution of a computation. ``hand, mock-up``: somebody chose it on emulated frames,
mostly of the mock-up; how well it holds for other targets is not known.
"""


@dataclass(frozen=True)
class Provenance:
    """Where the default of a tuning field comes from.

    Args:
        source: the kind of origin.
        note: the place: section or equation of a paper, the physical reason, or the campaign with its seeds,
            quantile and margin.
    """

    source: Origin
    note: str


BY_HAND = Provenance("hand, mock-up", "chosen on emulated frames; no derivation is recorded")
"""Of values without a recorded derivation."""
BUDGET = Provenance("numerics", "a budget of computation: the time grows with it")
"""Of numbers of steps, points and samples."""
WIDE_PRIOR = Provenance("hand, mock-up", "a wide prior; the value is chosen, not derived")
"""Of standard deviations that stand where nothing is observed."""
UNKNOWNS = Provenance("physics", "a pose has six unknowns, so that fewer equations determine none")
"""Of least numbers of points."""


class Tuning(Config):
    """Parameters that are no part of the promise; each field has a ``Provenance`` in its annotation.

    The provenance of a field that is a model itself holds for the fields in it that have none of their own.
    """


class TuningValue(NamedTuple):
    """A leaf of a tuning model."""

    path: str
    """Names of the fields that lead to it, with dots between."""
    provenance: Provenance | None
    """Where its default comes from; None where nothing says so."""


def public_fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return all leaves of a configuration model by name, those of ``Tuning`` models left out.

    A leaf is a field whose type holds no model. The fields of a model in a tuple count once. Of a field that
    takes one model of several, that of its default is looked into.
    """
    return {path: field for path, field, _ in _leaves(model, given=None, tuning=False)}


def tuning_values(model: type[BaseModel]) -> list[TuningValue]:
    """Return every leaf of a tuning model with its provenance, or that of the field around it."""
    return [TuningValue(path, provenance) for path, _, provenance in _leaves(model, given=None, tuning=True)]


def sources(values: list[TuningValue]) -> Counter[str]:
    """Return the number of values of each source; those without one count as ``none``."""
    return Counter(value.provenance.source if value.provenance else "none" for value in values)


def _leaves(
    model: type[BaseModel], *, given: Provenance | None, tuning: bool
) -> Iterator[tuple[str, FieldInfo, Provenance | None]]:
    hints = get_type_hints(model, include_extras=True)
    for name, field in model.model_fields.items():
        provenance = provenance_of(hints[name]) or given
        default = field.get_default(call_default_factory=True, validated_data={})
        chosen = isinstance(default, BaseModel)
        nested = [type(default)] if chosen else list(dict.fromkeys(models_in(hints[name])))
        if not nested:
            yield name, field, provenance
        for inner in nested:
            if tuning or not issubclass(inner, Tuning):
                for path, leaf, found in _leaves(inner, given=provenance, tuning=tuning):
                    yield f"{name}.{path}", leaf, found


def provenance_of(annotation: Any) -> Provenance | None:
    """Return the provenance in a field's annotation, None where there is none."""
    if get_origin(annotation) is not Annotated:
        return None
    return next((item for item in annotation.__metadata__ if isinstance(item, Provenance)), None)


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the configuration models that a field's annotation names, those in tuples and unions too."""
    if isinstance(annotation, type) and get_origin(annotation) is None and issubclass(annotation, BaseModel):
        yield annotation
        return
    arguments = get_args(annotation)
    for argument in arguments[:1] if get_origin(annotation) is Annotated else arguments:
        yield from models_in(argument)
