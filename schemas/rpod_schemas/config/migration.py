"""Configurations in logs: they carry a version, and those of earlier versions are read by today's models."""

import logging
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from rpod_schemas.config.base import RENAMED as RENAMED_IN_FILES
from rpod_schemas.config.base import check

Place = tuple[int | str, ...]
"""Keys that lead to a field of a document."""

CONFIG_VERSION = 7
"""Version of the configuration models.

1: all fields beside each other, and no version in the log. 2: fields outside the public interface are in
``tuning`` models. 3 and 5: fields have the names in ``RENAMED``. 4: a track is lost by its covariance, and
the navigator has no ``rejection_timeout_s`` and ``rejected_frames``. 5: the fields in ``TUNED`` are in
``tuning`` models. 6: the fields in ``MERGED`` are gone. 7: both, of these tables.
"""
_FIRST_WITH_TUNING = 2
"""First version whose logs have ``tuning`` models."""
RENAMED = {
    3: {
        "contrary_share": "inconsistent_share",
        "draw_in_points": "coarse_points",
        "draw_in_steps": "coarse_steps",
        "most_contrary_share": "most_inconsistent_share",
        "most_lacking": "most_missing",
        "settle_steps": "fine_steps",
        "sharpened_returns": "sufficient_returns",
    },
    5: RENAMED_IN_FILES,
}
"""Names that a version gave to fields, by the name before it."""
TUNED = {
    _FIRST_WITH_TUNING: None,
    5: frozenset({"attitudes"}),
    7: frozenset({"correlation_inflation", "near_search_s"}),
}
"""Names of the fields that a version moved into ``tuning``; None for any."""
MERGED: dict[int, dict[Place, Place]] = {
    6: {("navigator", "coasting_after_s"): ("stale_after_s",)},
    7: {("max_age_s",): ("filter", "max_delay_s")},
}
"""Places of the fields that a version removed, each with the place of the field that counts for both."""
VERSION_FIELD = "config_version"
"""Name of the version among the fields of a logged configuration."""

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class Migrated(Generic[Model]):
    """A logged configuration, as today's model has it."""

    config: Model
    """The configuration."""
    version: int
    """Version of the models with which it was logged."""
    tuned: tuple[str, ...] = ()
    """Names of the fields that are in a ``tuning`` model today; their values are kept."""
    renamed: tuple[str, ...] = ()
    """Old names of the fields that are renamed today, each with its new name; their values are kept."""
    unknown: tuple[str, ...] = ()
    """Names of the fields that today's model does not have; they are left out."""

    def report(self, source: str) -> None:
        """Log one line that names the fields that are moved, renamed or left out, if there are any."""
        parts = [
            ("now tuning", self.tuned),
            ("renamed", self.renamed),
            ("unknown and left out", self.unknown),
        ]
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

    A field that the model does not have is handled by the version of the log. If a later version renamed it
    (``RENAMED``), it gets its present name. If a later version made it tuning (``TUNED``), it is moved into
    the ``tuning`` model beside it. A field that still has no place is left out. The result names all these
    fields, but not one that repeated the value of the field that counts for both now (``MERGED``).

    Raises:
        ConfigurationError: a field that today's model has is wrong.
    """
    kept: dict[str, Any] = deepcopy(dict(document))
    stated = kept.pop(VERSION_FIELD, 1)
    version = stated if isinstance(stated, int) else 1
    origins: dict[Place, Place] = {}
    unknown: list[Place] = []
    names = renamed_since(version)
    while extra := _extra_fields(model, kept):
        for place in extra:
            origin = _origin(place, origins)
            origins.pop(place, None)
            if _repeats_another(kept, place, version):
                _remove(kept, place)
            elif _can_be_renamed(kept, place, names):
                origins[_rename(kept, place, names)] = origin
            elif _became_tuning(place, version):
                origins[_move(kept, place)] = origin
            else:
                _remove(kept, place)
                inner = [moved for moved in origins if moved[: len(place)] == place]
                unknown += [origins.pop(moved) for moved in inner] or [origin]

    def named(place: Place) -> str:
        return _name(place, without_tuning=version < _FIRST_WITH_TUNING)

    tuned = [old for place, old in origins.items() if place[-2:-1] == ("tuning",) and "tuning" not in old]
    renamed = [(old, place[-1]) for place, old in origins.items() if place[-1] != old[-1]]
    return Migrated(
        check(model, kept, source=source),
        version,
        tuned=tuple(map(named, tuned)),
        renamed=tuple(f"{named(old)} -> {new}" for old, new in renamed),
        unknown=tuple(map(named, unknown)),
    )


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


def _value(document: dict[str, Any], place: Place) -> Any:
    """Return the value of a field; None if a document does not have it."""
    value: Any = document
    for part in place:
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _move(document: dict[str, Any], place: Place) -> Place:
    """Move a field into the ``tuning`` beside it, and return its new place."""
    holder = _holder(document, place)
    holder.setdefault("tuning", {})[place[-1]] = holder.pop(place[-1])
    return (*place[:-1], "tuning", place[-1])


def _origin(place: Place, origins: Mapping[Place, Place]) -> Place:
    """Return the place of a field in the log; the field, or its holder, may have another place today."""
    held = next((size for size in range(len(place), 0, -1) if place[:size] in origins), 0)
    return origins[place[:held]] + place[held:] if held else place


def renamed_since(version: int) -> dict[str, str]:
    """Return the present names of fields by their names in a version, where these differ."""
    return {old: new for since, names in RENAMED.items() if version < since for old, new in names.items()}


def _became_tuning(place: Place, version: int) -> bool:
    """Return whether a version after the log's moved a field into a ``tuning`` model."""
    return "tuning" not in place and any(
        version < since and (names is None or place[-1] in names) for since, names in TUNED.items()
    )


def _repeats_another(document: dict[str, Any], place: Place, version: int) -> bool:
    """Return whether a later version merged a field with another one, which has the same value."""
    merged = {old: new for since, pairs in MERGED.items() if version < since for old, new in pairs.items()}
    return place in merged and _value(document, merged[place]) == _value(document, place)


def _can_be_renamed(document: dict[str, Any], place: Place, names: Mapping[str, str]) -> bool:
    """Return whether a field has a new name that no field beside it has yet."""
    return place[-1] in names and names[str(place[-1])] not in _holder(document, place)


def _rename(document: dict[str, Any], place: Place, names: Mapping[str, str]) -> Place:
    """Give a field its present name, and return its new place."""
    holder, name = _holder(document, place), names[str(place[-1])]
    holder[name] = holder.pop(place[-1])
    return (*place[:-1], name)


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
