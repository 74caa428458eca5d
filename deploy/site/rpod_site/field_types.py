"""Types, defaults and bounds of configuration fields, in the words of a configuration file."""

import types
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.config.sensor import Registered

Pages = Mapping[type[BaseModel], str]
"""Where each model's table stands."""
_NAMES: dict[Any, str] = {
    float: "number",
    int: "integer",
    str: "string",
    bool: "true or false",
    Path: "path",
    RigidTransform: "pose",
    Rotation: "rotation",
    type(None): "null",
    Any: "any",
}
_RULES = (
    (Gt, "gt", "> {}"),
    (Ge, "ge", "≥ {}"),
    (Lt, "lt", "< {}"),
    (Le, "le", "≤ {}"),
    (MinLen, "min_length", "length ≥ {}"),
    (MaxLen, "max_length", "length ≤ {}"),
)
_LONGEST_DEFAULT = 60


def type_text(annotation: Any, pages: Pages) -> str:
    """Return how a type is said in the table; models are links."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        installed = [each for each in arguments[1:] if isinstance(each, Registered)]
        models = [model for each in installed for model in each.models()]
        return " or ".join(type_text(model, pages) for model in models or arguments[:1])
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(type_text(argument, pages) for argument in arguments))
    if origin in (tuple, list, set, frozenset):
        return _sequence(arguments, pages)
    if origin is dict:
        return f"mapping of {type_text(arguments[0], pages)} to {type_text(arguments[1], pages)}"
    return _simple(annotation, pages)


def _simple(annotation: Any, pages: Pages) -> str:
    if annotation in pages:
        return f"[{annotation.__name__}]({pages[annotation]})"
    if get_origin(annotation) is Literal:
        return " or ".join(f"`{value}`" for value in get_args(annotation))
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " or ".join(f"`{member.value}`" for member in annotation)
    if np.ndarray in (annotation, get_origin(annotation)):
        return "list of numbers"
    return _NAMES.get(annotation) or f"`{getattr(annotation, '__name__', annotation)}`"


def _sequence(arguments: tuple[Any, ...], pages: Pages) -> str:
    texts = list(
        dict.fromkeys(type_text(argument, pages) for argument in arguments if argument is not Ellipsis)
    )
    if len(texts) > 1:
        return f"list of {len(arguments)}: {', '.join(texts)}"
    plural = f"{texts[0]}s" if texts[0] in _NAMES.values() else texts[0]
    return (
        f"list of {plural}" if len(arguments) == 1 or Ellipsis in arguments else f"{len(arguments)} {plural}"
    )


def default_text(value: Any, pages: Pages) -> str:
    """Return a default as a configuration file would have it."""
    if isinstance(value, BaseModel):
        of = type(value)
        return f"[{of.__name__}]({pages[of]})" if of in pages else f"`{of.__name__}`"
    if isinstance(value, RigidTransform | Rotation):
        identity = np.allclose(value.as_matrix(), np.eye(len(value.as_matrix())))
        return "identity" if identity else "see the code"
    if isinstance(value, tuple | list) and value and all(isinstance(each, BaseModel) for each in value):
        return ", ".join(default_text(each, pages) for each in value)
    text = _plain(value)
    return f"`{text}`" if len(text) <= _LONGEST_DEFAULT else f"`{text[:_LONGEST_DEFAULT]}...`"


def _plain(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(_plain(each) for each in value)}]"
    if isinstance(value, Enum):
        return str(value.value)
    return str(value) if value != "" else '""'


def bounds(field: FieldInfo) -> str:
    """Return the limits of a field and of the elements in it."""
    own = [_bound(rule) for rule in field.metadata]
    inner = [_bound(rule) for rule in _annotations(field.annotation)]
    texts = [text for text in own if text] + [f"each {text}" for text in inner if text]
    return ", ".join(dict.fromkeys(texts))


def _annotations(annotation: Any) -> list[Any]:
    """Return the rules within a type: those of the elements of a list, or of an optional value."""
    if get_origin(annotation) is Literal:
        return []
    arguments = get_args(annotation)
    found = list(arguments[1:]) if get_origin(annotation) is Annotated else []
    nested = [rule for argument in arguments for rule in _annotations(argument)]
    flat: list[Any] = []
    for rule in found:
        flat += rule.metadata if isinstance(rule, FieldInfo) else [rule]
    return flat + nested


def _bound(rule: Any) -> str:
    for kind, name, text in _RULES:
        if isinstance(rule, kind):
            return text.format(_plain(getattr(rule, name)))
    pattern = getattr(rule, "pattern", None)
    return f"fits `{pattern}`" if pattern else ""
