"""Configurations of earlier versions, as logs hold them: fields that are gone are left out, and named."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from rpod_schemas.config.base import check

Model = TypeVar("Model", bound=BaseModel)


def check_logged(model: type[Model], document: Mapping[str, Any], *, source: str) -> tuple[Model, list[str]]:
    """Validate a logged configuration against today's model.

    Returns:
        The configuration, and the names of the fields that today's model does not have.

    Raises:
        ConfigurationError: a field that today's model has is wrong.
    """
    kept: dict[str, Any] = deepcopy(dict(document))
    unknown: list[str] = []
    while True:
        try:
            return model.model_validate(kept), unknown
        except ValidationError as error:
            extra = [item["loc"] for item in error.errors() if item["type"] == "extra_forbidden"]
            if not extra:
                return check(model, kept, source=source), unknown
            for location in extra:
                _remove(kept, location)
                unknown.append(".".join(str(part) for part in location))


def _remove(document: dict[str, Any], location: Sequence[int | str]) -> None:
    """Remove a field; the parts of a location that name a kind of a union are no keys of the document."""
    place: Any = document
    for part in location[:-1]:
        if not isinstance(place, dict) or part in place:
            place = place[part]
    place.pop(location[-1])
