"""How much of the estimator's configuration is public, and where the values of the rest come from."""

import ast
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from rpod_schemas.config.base import Config, check
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput, PmdInput
from rpod_schemas.config.service import ServiceConfig
from rpod_schemas.config.surroundings import KnownSurroundings
from rpod_schemas.config.tuning import Provenance, Tuning, limits_in, provenance_of
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.sensors import methods, sensor_kinds
from rpod_sim_sensor.worlds import world_of
from rpod_site.sentences import described

MOST_PUBLIC_FIELDS = 78
"""For the whole estimator. A capability that needs more raises it, with a decision record."""
MOST_DECISIONS = 56
"""For a user: the same, but what a calibration writes into one file counts as one field."""
MOST_OF_SURROUNDINGS = 10
"""For a user whose frames show other things: fields of the file of known surroundings."""
MOST_BY_HAND = 81
"""Values that a hand fitted on emulated frames, mostly of the mock-up. It only ever falls."""
MOST_CONSTANTS_BY_HAND = 118
"""The same for numeric constants of pose estimation."""
POSE = Path(__file__).parents[3] / "services" / "rpod_pose"
SOURCE = re.compile(r"\b(Paper|Physics|Campaign|Numerics|Hand):\s+\S")
"""What a constant's docstring has before its reason: a source of ``Provenance``; ``Hand`` is the last one."""
NO_CHOICE = r"slice|np\.(zeros|empty)|[A-Z]"
"""Functions and records whose numbers are sizes, places, or fields that say what they are."""
LIMITS = Path(__file__).parents[3] / "docs" / "limits"
"""Results of the campaign that derives limits."""
MEASURED = ("sensors.pmd.calibration.", "sensors.pmd.camera.")
"""Fields whose figures a calibration writes into one file each."""
ADVICE = re.compile(r"\b(Set|Raise|Lower|[Cc]hange|Leave)\b")
"""What begins a sentence that tells a user when to touch a field."""
FEWEST_WORDS = 4
"""Fewest words of the sentence that tells what a field does."""


class TuningValue(NamedTuple):
    """A leaf of a tuning model."""

    path: str
    """Names of the fields that lead to the value, separated by dots."""
    provenance: Provenance | None
    """Source of the default; None if no field on the path states one."""


def public_fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return all leaves of a configuration model by name, those of ``Tuning`` models left out.

    A leaf is a field whose type holds no model. The fields of a model in a tuple count once. For a field that
    takes one of several models, the leaves of its default model count.
    """
    return {path: field for path, field, _ in _leaves(model, given=None, tuning=False)}


def tuning_values(model: type[BaseModel]) -> list[TuningValue]:
    """Return every leaf of a tuning model with its provenance, or that of the field around it."""
    return [TuningValue(path, provenance) for path, _, provenance in _leaves(model, given=None, tuning=True)]


def sources(values: list[TuningValue]) -> Counter[str]:
    """Return the number of values of each source; those without one count as ``none``."""
    return Counter(value.provenance.source if value.provenance else "none" for value in values)


def constants(source: str) -> dict[str, str]:
    """Return the docstrings of a module's numeric constants by name.

    Numbers in a call of ``NO_CHOICE`` do not count, nor does 0 or 1.
    """
    found = {}
    for node, after in pairwise([*ast.parse(source).body, ast.Pass()]):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value and _has_choice(node.value):
            said = after.value if isinstance(after, ast.Expr) else None
            name = ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target)
            found[name] = str(said.value) if isinstance(said, ast.Constant) else ""
    return found


def _has_choice(node: ast.AST) -> bool:
    if isinstance(node, ast.Call) and re.match(NO_CHOICE, ast.unparse(node.func)):
        return False
    if isinstance(node, ast.Constant):
        return type(node.value) in {int, float} and node.value not in {0, 1}
    return any(_has_choice(child) for child in ast.iter_child_nodes(node))


def _leaves(
    model: type[BaseModel], *, given: Provenance | None, tuning: bool
) -> Iterator[tuple[str, FieldInfo, Provenance | None]]:
    hints = get_type_hints(model, include_extras=True)
    for name, field in described(model).items():
        provenance = provenance_of(hints[name]) or given
        default = field.get_default(call_default_factory=True, validated_data={})
        chosen = isinstance(default, BaseModel)
        nested = [type(default)] if chosen else list(dict.fromkeys(_models_in(hints[name])))
        if not nested:
            yield name, field, provenance
        for inner in nested:
            if tuning or not issubclass(inner, Tuning):
                for path, leaf, found in _leaves(inner, given=provenance, tuning=tuning):
                    yield f"{name}.{path}", leaf, found


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the configuration models that a field's annotation names, those in tuples and unions too."""
    if isinstance(annotation, type) and get_origin(annotation) is None and issubclass(annotation, BaseModel):
        yield annotation
        return
    arguments = get_args(annotation)
    for argument in arguments[:1] if get_origin(annotation) is Annotated else arguments:
        yield from _models_in(argument)


def estimator_fields() -> dict[str, FieldInfo]:
    """All public leaves, of one LIDAR and one PMD camera with their default methods.

    What every service has (its bus, its name) is the facility's, and ``source`` describes the driver of
    another party. The parameters of the papers' methods are documented with them. None of these is counted,
    nor a ``kind`` inside a method that has one value only. All that a calibration file holds is.
    """
    found = {
        name: field
        for name, field in public_fields(EstimatorConfig).items()
        if name.split(".")[0] not in {"sensors", *ServiceConfig.model_fields}
    }
    for model in (LidarInput, PmdInput):
        kind = model.model_fields["kind"].default
        found |= {
            f"sensors.{kind}.{name}": field
            for name, field in public_fields(model).items()
            if not name.startswith("source.")
        }
    del found["sensors.lidar.acquisition.tracking.kind"]
    return found


def below(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for child in model.__subclasses__():
        if child.__module__.startswith("rpod_schemas."):
            yield child
            yield from below(child)


def tuning_roots() -> list[type[BaseModel]]:
    """Every model that stands as ``tuning`` in a configuration of the project."""
    for kind in sensor_kinds():
        methods(kind.name)
    fields = (model.model_fields.get("tuning") for model in below(Config))
    defaults = [field.default for field in fields if field is not None]
    roots = {type(default) for default in defaults if isinstance(default, BaseModel)}
    return sorted(roots, key=lambda model: model.__name__)


def test_the_estimator_has_no_more_public_fields_than_decided(
    record_property: Callable[[str, object], None],
) -> None:
    names = estimator_fields()
    record_property("measured", f"{len(names)} public fields of the estimator, {MOST_PUBLIC_FIELDS} at most")
    assert len(names) <= MOST_PUBLIC_FIELDS, "\n".join(names)


def test_a_user_has_no_more_decisions_than_decided() -> None:
    """Intrinsics and errors of distances are measured: their fields are figures of one file each."""
    decisions = {
        next((file for file in MEASURED if name.startswith(file)), name) for name in estimator_fields()
    }
    assert set(MEASURED) < decisions
    assert len(decisions) <= MOST_DECISIONS


def test_the_file_of_surroundings_has_no_more_fields_than_decided() -> None:
    assert len(public_fields(KnownSurroundings)) <= MOST_OF_SURROUNDINGS


def test_every_public_field_has_a_sentence() -> None:
    mute = {
        name
        for name, field in (estimator_fields() | public_fields(KnownSurroundings)).items()
        if len((field.description or "").split()) < FEWEST_WORDS and ".camera." not in name
    }
    assert {name for name in mute if not name.endswith(".kind")} == set()


def test_every_decision_says_when_to_touch_the_field() -> None:
    """Figures of a calibration, intrinsics and the choice of a method need no advice of their own."""
    untold = {
        name
        for name, field in estimator_fields().items()
        if not ADVICE.search(field.description or "") and not name.startswith(MEASURED)
    }
    assert {name for name in untold if not name.endswith(".kind")} == set()


def test_every_tuning_value_says_where_it_comes_from(record_property: Callable[[str, object], None]) -> None:
    values = {root: tuning_values(root) for root in tuning_roots()}
    without = [
        f"{root.__name__}.{value.path}"
        for root, of in values.items()
        for value in of
        if value.provenance is None or not value.provenance.note
    ]
    assert not without, f"no provenance: {', '.join(without)}"
    counts = sources([value for of in values.values() for value in of])
    told = ", ".join(f"{count} {source}" for source, count in counts.most_common())
    record_property("measured", f"{counts.total()} tuning values: {told}")
    assert counts["hand, mock-up"] <= MOST_BY_HAND


def test_every_constant_of_pose_estimation_says_why_it_has_its_value(
    record_property: Callable[[str, object], None],
) -> None:
    files = {str(file.relative_to(POSE)): file.read_text("utf-8") for file in sorted(POSE.rglob("*.py"))}
    told = {
        f"{file}: {name}": SOURCE.findall(text)
        for file, content in files.items()
        for name, text in constants(content).items()
    }
    assert not [name for name, found in told.items() if not found]
    counts = Counter(source for found in told.values() for source in found)
    listed = ", ".join(f"{count} {source}" for source, count in counts.most_common())
    record_property("measured", f"{len(told)} numeric constants: {listed}")
    assert counts["Hand"] <= MOST_CONSTANTS_BY_HAND


def test_a_constant_without_a_reason_is_found() -> None:
    source = 'A, B = 2, np.arange(3)\n"""Two. Hand: half of four."""\nC: float = -0.5\nD = np.zeros(1)\n'
    found = constants(source)
    assert set(found) == {"(A, B)", "C"}
    assert [SOURCE.findall(text) for text in found.values()] == [["Hand"], []]


@pytest.mark.parametrize("model", [LidarInput, PmdInput])
def test_a_derived_limit_is_the_one_of_the_campaign_that_it_names(model: type[LidarInput | PmdInput]) -> None:
    sensor = model()
    told = json.loads((LIMITS / f"{sensor.kind}.json").read_text())["totals"]
    fields = limits_in(sensor.tracking)
    assert {each.path for each in fields} == set(told["limits"])
    assert not [name for name in told["worlds"] if world_of(name).held_out], "no limit may be chosen by these"
    for each in fields:
        assert each.provenance is not None
        if each.provenance.source == "campaign":
            assert each.value == told["limits"][each.path]["derived"]
            assert f"seed {told['seed']}, {told['bodies']} satellites" in each.provenance.note


def test_every_tuning_model_is_part_of_a_configuration() -> None:
    reached: set[type[BaseModel]] = set()
    open_ = list(tuning_roots())
    while open_:
        model = open_.pop()
        reached.add(model)
        nested = (type(field.default) for field in model.model_fields.values())
        open_ += [each for each in nested if issubclass(each, BaseModel) and each not in reached]
    assert all(issubclass(root, Tuning) for root in tuning_roots())
    missing = {model.__name__ for model in below(Tuning)} - {model.__name__ for model in reached}
    assert missing == {"SearchLevelConfig"}  # which stands in a tuple, and has its values there


class Inner(Tuning):
    told: int = 1


class Outer(Tuning):
    bare: float = 0.5
    inner: Inner = Inner()


def test_a_value_without_provenance_is_found() -> None:
    assert [(value.path, value.provenance) for value in tuning_values(Outer)] == [
        ("bare", None),
        ("inner.told", None),
    ]
    assert sources(tuning_values(Outer)) == {"none": 2}


def test_tuning_is_not_public_and_what_stands_beside_is() -> None:
    assert "tuning.gate_nis" not in public_fields(EstimatorConfig)
    assert not any("tuning" in name for name in estimator_fields())
    assert {"sensors.pmd.tracking.slack_m", "sensors.pmd.camera.fx", "filter.position_floor_m"} < set(
        estimator_fields()
    )
    assert isinstance(tuning_values(tuning_roots()[0])[0].provenance, Provenance)


@pytest.mark.parametrize(
    ("document", "place"),
    [
        ({"filter": {"gate_nis": 12.0}}, "filter.tuning.gate_nis"),
        ({"filter": {"correlation_inflation": 4.0}}, "filter.tuning.correlation_inflation"),
        ({"navigator": {"near_search_s": 2.0}}, "navigator.tuning.near_search_s"),
        (
            {"sensors": [{"kind": "pmd", "tracking": {"kind": "joint", "depth": {"points": 9}}}]},
            "sensors.0.tracking.tuning.depth",
        ),
    ],
)
def test_the_error_of_a_field_that_became_tuning_names_its_place(
    document: dict[str, object], place: str
) -> None:
    whole = {"target": "mockup", "sensors": [{"kind": "pmd"}], **document}
    with pytest.raises(ConfigurationError, match=re.escape(f"write it as {place}")):
        check(EstimatorConfig, whole, source="run.yaml")


def test_the_error_of_a_field_that_was_renamed_has_its_present_name() -> None:
    document = {"target": "mockup", "sensors": [{"kind": "pmd", "thinned": {"mbit_s": 8}}]}
    with pytest.raises(ConfigurationError, match=r"sensors\.0\.thinned: is called reduced_rate now"):
        check(EmulatorConfig, document, source="run.yaml")


def test_the_error_of_a_field_that_nobody_knows_names_no_tuning() -> None:
    whole = {"target": "mockup", "sensors": [{"kind": "pmd"}], "filter": {"gone": 1}}
    with pytest.raises(ConfigurationError, match=r"filter\.gone") as raised:
        check(EstimatorConfig, whole, source="run.yaml")
    assert "tuning" not in str(raised.value)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"navigator": {"coasting_after_s": 0.3}}, r"coasting_after_s: is gone: remove it; .* stale_after_s"),
        ({"max_age_s": 3.0}, r"max_age_s: is gone: remove it; filter\.max_delay_s counts for it"),
    ],
)
def test_the_error_of_a_field_that_is_gone_names_the_one_that_counts_for_it(
    given: dict[str, object], words: str
) -> None:
    document = {"target": "mockup", "sensors": [{"kind": "pmd"}], **given}
    with pytest.raises(ConfigurationError, match=words):
        check(EstimatorConfig, document, source="run.yaml")
