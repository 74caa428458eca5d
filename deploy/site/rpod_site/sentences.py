"""Sentences of fields: the docstrings below them, read from the source when they are asked for.

pydantic would read them at the import of each model (``use_attribute_docstrings``), which is a third of the
time of importing all configurations. A service does not need them; the pages of the reference do.
"""

import inspect
import sys
from functools import cache
from pathlib import Path

import griffe
from pydantic import BaseModel
from pydantic.fields import FieldInfo


def described(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model by name, those without a ``description`` with their docstring as such."""
    for name, field in model.model_fields.items():
        if field.description is None:
            declaring = next(base for base in model.__mro__ if name in inspect.get_annotations(base))
            docstring = _module(declaring.__module__)[f"{declaring.__qualname__}.{name}"].docstring
            field.description = docstring and docstring.value
    return model.model_fields


@cache
def _module(name: str) -> griffe.Module:
    """Return what the source of an imported module declares, read as mkdocstrings reads it."""
    file = Path(inspect.getfile(sys.modules[name]))
    return griffe.visit(name, file, file.read_text("utf-8"))
