"""Configurations as logs hold them: with a version, and how those of earlier versions are read today."""

import logging
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from rpod_schemas.config.base import check

CONFIG_VERSION = 2
"""Version of the configuration models. 1: all fields beside each other, and no version in the log.
2: what is no part of the promise stands in ``tuning`` models."""
VERSION_FIELD = "config_version"
"""Name of the version among the fields of a logged configuration."""

Model = TypeVar("Model", bound=BaseModel)
Place = tuple[int | str, ...]


@dataclass(frozen=True)
class Migrated(Generic[Model]):
    """A logged configuration, as today's model has it."""

    config: Model
    """The configuration."""
    version: int
    """Version of the models with which it was logged."""
    tuned: tuple[str, ...] = ()
    """Names of the fields that stand in a ``tuning`` model today; their values are kept."""
    unknown: tuple[str, ...] = ()
    """Names of the fields that today's model does not have; they are left out."""

    def report(self, source: str) -> None:
        """Log one line that names what has become tuning and what is left out, where there is any."""
        parts = [("now tuning", self.tuned), ("unknown and left out", self.unknown)]
        text = "; ".join(f"{what}: {_grouped(names)}" for what, names in parts if names)
        if text:
            logging.getLogger(__name__).warning(
                "%s: is of version %d, today's is %d; %s", source, self.version, CONFIG_VERSION, text
            )


def logged(config: BaseModel) -> dict[str, Any]:
    """Return a resolved configuration as a JSON object for a log, with the version of its model."""
    return {VERSION_FIELD: CONFIG_VERSION, **config.model_dump(mode="json")}


def check_logged(model: type[Model], document: Mapping[str, Any], *, source: str) -> Migrated[Model]:
    """Validate a logged configuration against today's model.

    Of a version before 2, a field that its model does not have is sought in the model's ``tuning``, and its
    value is moved there. A field that is in neither is left out. Both are named.

    Raises:
        ConfigurationError: a field that today's model has is wrong.
    """
    kept: dict[str, Any] = deepcopy(dict(document))
    told = kept.pop(VERSION_FIELD, 1)
    version = told if isinstance(told, int) else 1
    tuned: dict[Place, str] = {}
    unknown: list[str] = []
    while extra := _extra_fields(model, kept):
        for place in extra:
            if version < CONFIG_VERSION and "tuning" not in place:
                tuned[_move(kept, place)] = _name(place)
                continue
            _remove(kept, place)
            gone = [moved for moved in tuned if moved[: len(place)] == place]
            unknown += [tuned.pop(moved) for moved in gone] or [
                _name(place, without_tuning=version < CONFIG_VERSION)
            ]
    return Migrated(check(model, kept, source=source), version, tuple(tuned.values()), tuple(unknown))


def _extra_fields(model: type[BaseModel], document: dict[str, Any]) -> list[Place]:
    """Return the places in a document for which a model has no field."""
    try:
        model.model_validate(document)
    except ValidationError as error:
        places = [item["loc"] for item in error.errors() if item["type"] == "extra_forbidden"]
        return [_keys(document, place) for place in places]
    return []


def _keys(document: dict[str, Any], location: Sequence[int | str]) -> Place:
    """Return the keys that lead to a field: a location may name the kind of a union too, which is none."""
    place: Any = document
    keys: list[int | str] = []
    for part in location[:-1]:
        if not isinstance(place, dict) or part in place:
            place = place[part]
            keys.append(part)
    return (*keys, location[-1])


def _holder(document: dict[str, Any], place: Place) -> Any:
    """Return the mapping that holds a field."""
    holder: Any = document
    for part in place[:-1]:
        holder = holder[part]
    return holder


def _move(document: dict[str, Any], place: Place) -> Place:
    """Move a field into the ``tuning`` beside it, and return its new place."""
    holder = _holder(document, place)
    holder.setdefault("tuning", {})[place[-1]] = holder.pop(place[-1])
    return (*place[:-1], "tuning", place[-1])


def _remove(document: dict[str, Any], place: Place) -> None:
    _holder(document, place).pop(place[-1])


def _grouped(names: Sequence[str]) -> str:
    """Return names with those of one holder together: ``a.b (c, d), a.e``."""
    of_holder: dict[str, list[str]] = {}
    for name in names:
        holder, _, field = name.rpartition(".")
        of_holder.setdefault(holder, []).append(field)
    return ", ".join(
        f"{holder} ({', '.join(fields)})" if holder else ", ".join(fields)
        for holder, fields in of_holder.items()
    )


def _name(place: Place, *, without_tuning: bool = False) -> str:
    return ".".join(str(part) for part in place if not (without_tuning and part == "tuning"))
