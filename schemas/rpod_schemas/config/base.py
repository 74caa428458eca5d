"""Base of every configuration: strict models, and files whose errors name the wrong field."""

import reprlib
import tomllib
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from copy import deepcopy
from difflib import get_close_matches
from itertools import chain, islice
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from rpod_schemas.errors import ConfigurationError
from rpod_schemas.strict_yaml import read_yaml
from rpod_schemas.texts import shown

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(gt=0)]
_NAME = r"^[A-Za-z][A-Za-z0-9_-]*$"
Name = Annotated[str, Field(pattern=_NAME)]
ROS_NAME = r"^[A-Za-z][A-Za-z0-9_]*$"
"""Pattern of a name that is one level of a topic."""
ENDPOINT = r"^(tcp|tls|quic|unixsock-stream)/.+"
"""Pattern of an endpoint of Zenoh."""
ZENOH_ID = r"^[0-9a-f]{1,32}$"
"""Pattern of an identity of a Zenoh session."""
NAMESPACE = r"^([A-Za-z0-9_]+(/[A-Za-z0-9_]+)*)?$"
"""Pattern of the namespace of a ROS 2 node, without the leading slash."""
BUS_NAMESPACE = r"^([A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*)?$"
"""Pattern of the namespace of a facility on the bus."""
TOPIC = r"^/?[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$"
"""Pattern of a topic's name."""
_PATTERNS = {
    _NAME: "needs a letter, then letters, digits, '_' or '-'",
    ROS_NAME: "needs a letter, then letters, digits or '_'",
    ENDPOINT: "needs an endpoint of Zenoh, such as tcp/127.0.0.1:7447",
    BUS_NAMESPACE: "needs names that begin with a letter, with '/' between two, as lab/north",
    NAMESPACE: "needs names of letters, digits and '_' with '/' between two, as robot1/camera",
    TOPIC: "needs names of letters, digits, '_' or '-' with '/' between two, as /camera/depth/image_raw",
    ZENOH_ID: "needs 1 to 32 digits from 0 to 9 and a to f, such as e57a7e",
}
"""Requirement on a text in words, by its pattern."""
_NAMED_FIELDS = "a mapping, that is named fields"
_FORMS = {
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": _NAMED_FIELDS,
    "model_type": _NAMED_FIELDS,
    "model_attributes_type": _NAMED_FIELDS,
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "string_type": "a text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}
"""Form that a field needs, by Pydantic's name of the error for any other form."""
_OF_UNIONS = ("constrained-", "function-")
"""Beginnings of Pydantic's names for types in a place that are no fields."""
_KEY = "[key]"
"""Pydantic's place of a wrong name of a field, behind this name."""
_UNKNOWN = "extra_forbidden"
"""Pydantic's name of the error that a field is not known."""
_LONGEST_QUOTED = 200
"""Length of a wrong text in an error."""
_MOST_NAMED = 3
"""Number of further wrong fields that an error names."""


class Config(BaseModel):
    """Base of the models: frozen, closed to unknown fields, described by the docstrings under the fields.

    Only the reference reads these (``rpod_site.sentences``): pydantic would parse the source of every model
    at each start of a service.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


class _Live:
    """Marks a field that may change while its service runs."""


LIVE = _Live()
"""Beside the type of a field: a running service takes a new value when it reads its file again."""


def live_fields(model: type[BaseModel]) -> tuple[str, ...]:
    """Return the names of the fields of a configuration that may change while its service runs."""
    return tuple(name for name, field in model.model_fields.items() if LIVE in field.metadata)


_MOST_BYTES, _MOST_VALUES, _MOST_LEVELS = 8 << 20, 1_000_000, 50
_MOST_FILES = 1000
"""Largest number of files in a folder whose names are compared with that of a missing file."""
_ALIKE = 0.8
"""Least likeness of a file's name that is proposed, 1 if equal (``difflib``); unlike names mislead."""
_being_read: ContextVar[tuple[Path, ...]] = ContextVar("being_read", default=())
"""Files whose content is being checked, from the outermost one on: no field of theirs means one of these."""
_TOO_DEEP = f"is nested more than {_MOST_LEVELS} levels deep; no field of a configuration is"
Model = TypeVar("Model", bound=BaseModel)


def read_document(path: Path) -> dict[str, Any]:
    """Read a YAML, JSON or TOML file as a dictionary.

    Raises:
        ConfigurationError: the file is missing, unreadable, or no mapping.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(_MOST_BYTES + 1)
        if len(data) > _MOST_BYTES:
            raise ConfigurationError(
                path, "", f"is larger than {_MOST_BYTES >> 20} MiB; is it the right file?"
            )
        text = data.decode("utf-8")
    except OSError as error:
        raise ConfigurationError(path, "", f"cannot be read ({error.strerror}){_meant(path)}") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(path, "", "is not UTF-8 text") from error
    try:
        document = tomllib.loads(text) if path.suffix == ".toml" else read_yaml(text)
    except (ValueError, yaml.YAMLError) as error:  # of TOML, also for a number of too many digits
        raise ConfigurationError(path, "", _syntax(error)) from error
    except RecursionError as error:
        raise ConfigurationError(path, "", _TOO_DEEP) from error
    _check_size(document, path)
    if not isinstance(document, dict):
        raise ConfigurationError(path, "", "needs named fields at its top level")
    return document


def _meant(path: Path) -> str:
    """Return a hint at the file that was meant, or at the folder that does not exist."""
    folder, being_read = path.parent, _being_read.get()
    try:
        if not folder.is_dir():
            return f": there is no folder {folder}"
        files = [each for each in islice(folder.iterdir(), _MOST_FILES) if each.suffix == path.suffix]
        if path in files:
            return ""
        names = [each.name for each in files if each.absolute() not in being_read]
    except OSError:
        return ""
    if meant := get_close_matches(path.name, names, n=1, cutoff=_ALIKE):
        return f"; did you mean {folder / meant[0]}?"
    return "" if path.is_absolute() else f" in {folder.absolute()}"


def _syntax(error: Exception) -> str:
    """Return where a file cannot be parsed, and why."""
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return " ".join(str(error).split())
    mark, problem = error.problem_mark, error.problem or ""
    if "expected ':'" in problem and error.context_mark is not None:
        mark = error.context_mark  # the line without a colon; the problem is seen on the next one
    if "'\\t'" in problem:
        problem = "there is a tab; YAML is indented with spaces"
    return f"line {mark.line + 1}, column {mark.column + 1}: {problem}"


def _check_size(document: Any, path: Path) -> None:
    """Raise ``ConfigurationError`` for a document nested too deeply, or too large by YAML's aliases."""
    level, values = [document], 0
    for _ in range(_MOST_LEVELS):
        values += len(level)
        if values > _MOST_VALUES:
            raise ConfigurationError(path, "", f"has more than {_MOST_VALUES:,} values; write fewer aliases")
        inner = (
            node.values() if isinstance(node, dict) else node
            for node in level
            if isinstance(node, dict | list)
        )
        level = list(islice(chain.from_iterable(inner), _MOST_VALUES))
        if not level:
            return
    raise ConfigurationError(path, "", _TOO_DEEP)


RENAMED = {"sharp_share": "accurate_share", "thinned": "reduced_rate", "verdict": "acceptance"}
"""Present names of fields of configuration files, by their former names."""


REMOVED = {
    "coasting_after_s": "remove it; the estimator's stale_after_s counts for it too",
    "max_age_s": "remove it; filter.max_delay_s counts for it too",
}
"""Remedies for fields that configuration files do not have any more, by name."""


def check(model: type[Model], document: Any, *, source: Path | str) -> Model:
    """Validate a document against a model.

    Raises:
        ConfigurationError: names the source, the first field that is wrong, and why.
    """
    outer = _being_read.set((*_being_read.get(), Path(source).absolute()))
    try:
        return model.model_validate(document)
    except ValidationError as error:
        problem, *others = sorted(_problems(error), key=lambda each: each["type"] != _UNKNOWN)
        reason = _reason(model, document, problem)
        places = dict.fromkeys(_place(each["loc"]) for each in others)  # once for each member of a union
        further = [place for place in places if place != _place(problem["loc"])]
        if further:
            named = further[:_MOST_NAMED] + ["..."] * (len(further) > _MOST_NAMED)
            reason += f" (and {len(further)} more: {', '.join(named)})"
        raise ConfigurationError(source, _place(problem["loc"]), reason) from error
    finally:
        _being_read.reset(outer)


def _place(location: Sequence[int | str]) -> str:
    """Return a field's place without Pydantic's names for the members of a union of plain types."""
    return ".".join(str(part) for part in location if not str(part).startswith(_OF_UNIONS) and part != _KEY)


def _reason(model: type[BaseModel], document: Any, problem: ErrorDetails) -> str:
    """Return why a field is refused, with its value and the remedy."""
    reason, value, given = problem["msg"], problem["input"], problem.get("ctx", {})
    _, should, needs = reason.partition(" should ")
    if problem["type"] == _UNKNOWN:
        reason = _unknown(model, document, problem["loc"])
    elif problem["type"] == "missing":
        reason = "is missing; this field has no default"
    elif problem["type"] == "union_tag_not_found":
        reason = f"{given['discriminator']} is missing; it states what kind this is"
    elif problem["type"] == "union_tag_invalid":
        reason = f"{given['discriminator']} is {given['tag']!r}; it must be one of {given['expected_tags']}"
    elif problem["type"] == "string_pattern_mismatch":
        reason = f"is {_quoted(value)}; {_PATTERNS.get(given.get('pattern', ''), reason)}"
    elif problem["type"] in _FORMS:
        reason = f"is {reprlib.repr(value)}; it must be {_FORMS[problem['type']]}"
    elif problem["type"] == "too_short":
        reason = f"has {given['actual_length']} items; it needs {given['min_length']} at least"
    elif should:
        reason = f"is {reprlib.repr(value)}; it must {needs}"
    return reason.removeprefix("Value error, ")


def _quoted(value: Any) -> str:
    """Return a text in quotes, shortened if it is longer than any name, topic or endpoint."""
    return shown(repr(value), _LONGEST_QUOTED)


def _unknown(model: type[BaseModel], document: Any, location: Sequence[int | str]) -> str:
    """Return what to do about a field that is not known: its new place, or the nearest known name."""
    if _is_tuning(model, document, location):
        return f"is a tuning field now: write it as {_place((*location[:-1], 'tuning', location[-1]))}"
    if name := RENAMED.get(str(location[-1])):
        return f"is called {name} now: write it so"
    if remedy := REMOVED.get(str(location[-1])):
        return f"is gone: {remedy}"
    meant = get_close_matches(str(location[-1]), _fields(model, location[:-1]), n=1)
    guess = f"did you mean {meant[0]}?" if meant else "check its spelling and its place"
    return f"is not a known field; {guess}"


def _fields(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """Return the names of the fields that the models at a place of a document have."""
    models = [model]
    for part in location:
        holders = [each for each in models if part in each.model_fields]
        if holders:  # otherwise an index of a list, or a kind that chooses among the models of a union
            annotations = [each.model_fields[str(part)].annotation for each in holders]
            models = [found for annotation in annotations for found in _models(annotation)]
    return [name for each in models for name in each.model_fields]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models in an annotation, such as those of a list or a union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in get_args(annotation) for found in _models(part)]


def _problems(error: ValidationError) -> list[ErrorDetails]:
    """Return the errors without those that follow from others: a list of wrong items is also too short."""
    problems = error.errors(include_url=False)
    places = [problem["loc"] for problem in problems]
    return [
        problem
        for problem in problems
        if problem["type"] != "too_short"
        or not any(place[: len(problem["loc"])] == problem["loc"] != place for place in places)
    ]


def _is_tuning(model: type[BaseModel], document: Any, location: Sequence[int | str]) -> bool:
    """Return whether an unknown field is known in the ``tuning`` model beside it."""
    holder = copied = deepcopy(document)
    for part in location[:-1]:
        if not isinstance(holder, dict) or part in holder:
            holder = holder[part]
    if not isinstance(holder, dict) or not isinstance(holder.setdefault("tuning", {}), dict):
        return False
    holder["tuning"][location[-1]] = holder.pop(location[-1])
    beside = (*location[:-1], "tuning")
    try:
        model.model_validate(copied)
    except ValidationError as error:
        unknown = [item["loc"] for item in error.errors() if item["type"] == "extra_forbidden"]
        return beside not in unknown and (*beside, location[-1]) not in unknown
    return True


def write(document: BaseModel, path: Path) -> Path:
    """Write a model as JSON or YAML, by the suffix of the path, so that ``load`` reads it; return the path.

    Raises:
        OSError: the file cannot be written.
    """
    if path.suffix == ".json":
        text = document.model_dump_json(indent=2) + "\n"
    else:
        text = yaml.safe_dump(document.model_dump(mode="json"), sort_keys=False)
    path.write_text(text, encoding="utf-8")
    return path


def load(model: type[Model], path: Path) -> Model:
    """Read and validate a configuration file. Raises ``ConfigurationError``."""
    return check(model, read_document(path), source=path)


def in_place(value: Any, read: Callable[[Path], Any]) -> Any:
    """Return the content of a file, by ``read``, if a value is the path of one; else the value itself.

    An error of the file is reported as one of the field that names it: ``ValueError`` in a validator.
    """
    if not isinstance(value, str | Path):
        return value
    try:
        return read(Path(value))
    except ConfigurationError as error:
        raise ValueError(str(error)) from error
