"""Tuning: parameters of a method outside the public interface, each with its provenance.

A public field of a configuration stays from version to version, and its description says when to change it.
A field of a ``tuning`` model may change its name or its value, or vanish, in any version. ``Provenance``
states the source of its default. Values of the source ``campaign`` are written by the command that derives
limits from a population of targets and worlds; their note names campaign, seeds, quantile and margin.
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_origin, get_type_hints

from pydantic import BaseModel

from rpod_schemas.config.base import Config

MarkT = TypeVar("MarkT")
Origin = Literal["paper", "physics", "campaign", "numerics", "hand, mock-up"]
"""Source of a value.

``paper``: a publication states it. ``physics``: it follows from a law, a definition or the statistics of a
distribution. ``campaign``: a campaign over many targets derived it. ``numerics``: it trades time against the
convergence or the resolution of a computation. ``hand, mock-up``: somebody chose it on emulated frames,
mostly of the mock-up; its validity for other targets is not known.
"""


@dataclass(frozen=True)
class Provenance:
    """Source of the default of a tuning field.

    Args:
        source: the kind of origin.
        note: the place: section or equation of a paper, the physical reason, or the campaign with its seeds,
            quantile and margin.
    """

    source: Origin
    note: str


@dataclass(frozen=True)
class Limit:
    """Mark of a tuning field that limits one number of a belief's evidence.

    Args:
        evidence: name of the number.
        least: whether the field is the least allowed number; otherwise it is the greatest.
        usual: share of right poses that meet the limit by intention, for a limit that only warns; None for
            one that refuses.
    """

    evidence: str
    least: bool = False
    usual: float | None = None


BY_HAND = Provenance("hand, mock-up", "chosen on emulated frames; no derivation is recorded")
"""Provenance of values without a recorded derivation."""
BUDGET = Provenance("numerics", "a budget of computation: the time grows with it")
"""Provenance of numbers of steps, points and samples."""
GRID = Provenance("numerics", "half the angle between neighbours of the finest grid of attitudes")
"""Provenance of angles within which two attitudes are the same."""
FIRST_STEP = Provenance("numerics", "the steps narrow from it: a wider one converges from farther, slower")
"""Provenance of scales of first steps."""
ONE_IN_TWENTY = Provenance("physics", "a probability: one in twenty such poses may be wrong by itself")
"""Provenance of weights of hypotheses."""
OF_CAMERA = Provenance(
    "hand, mock-up",
    "a length of the camera, whatever it looks at: it follows from the modulation; the value is chosen",
)
"""Provenance of errors of a time-of-flight camera's ranges."""
UNKNOWN_ANGLE = Provenance("physics", "the standard deviation of an angle of which nothing is known")
"""Provenance of standard deviations for unobserved rotations."""
THREE_SIGMA = Provenance("physics", "one in 370 normal errors is larger than three standard deviations")
"""Provenance of distances beyond which an error is no noise."""
POPULATION_PMD, POPULATION_LIDAR = (
    Provenance(
        "campaign",
        f"rpod campaign limits --sensor {sensor}, seed 5, 12 satellites, quantile 0.995, margin 0.1; "
        f"docs/limits/{sensor}.json has its worlds and intervals",
    )
    for sensor in ("pmd", "lidar")
)
"""Provenance of limits that are derived from a population of targets and worlds."""
UNKNOWNS = Provenance("physics", "a pose has six unknowns, so that fewer equations determine none")
"""Provenance of least numbers of points."""


class Tuning(Config):
    """Parameters outside the public interface; each field has a ``Provenance`` in its annotation.

    The provenance of a field that is itself a model applies to the fields in it that have none of their own.
    """


class LimitField(NamedTuple):
    """A limit in a configuration."""

    path: str
    """Names of the fields that lead to it, separated by dots."""
    value: float
    limit: Limit
    provenance: Provenance | None

    @property
    def is_whole(self) -> bool:
        """Whether the limit is a whole number."""
        return isinstance(self.value, int)


def limits_in(config: BaseModel) -> list[LimitField]:
    """Return the limits of evidence in a configuration and in the models that it holds."""
    found = []
    hints = get_type_hints(type(config), include_extras=True)
    for name in type(config).model_fields:
        value, limit = getattr(config, name), _mark(hints[name], Limit)
        if limit is not None:
            found.append(LimitField(name, value, limit, provenance_of(hints[name])))
        elif isinstance(value, BaseModel):
            found += [each._replace(path=f"{name}.{each.path}") for each in limits_in(value)]
    return found


def provenance_of(annotation: Any) -> Provenance | None:
    """Return the provenance in a field's annotation, None if there is none."""
    return _mark(annotation, Provenance)


def _mark(annotation: Any, kind: type[MarkT]) -> MarkT | None:
    """Return the first mark of a kind in a field's annotation, None if there is none."""
    if get_origin(annotation) is not Annotated:
        return None
    return next((item for item in annotation.__metadata__ if isinstance(item, kind)), None)
