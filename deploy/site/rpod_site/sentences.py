"""Sentences of fields: the docstrings below them, read from the source when they are asked for.

pydantic would read them at the import of each model (``use_attribute_docstrings``), which is a third of the
time of importing all configurations. A service does not need them; the pages of the reference do.
"""

import ast
import inspect
from functools import cache
from itertools import pairwise
from textwrap import dedent

from pydantic import BaseModel
from pydantic.fields import FieldInfo


def described(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model by name, those without a ``description`` with their docstring as such."""
    for name, field in model.model_fields.items():
        if field.description is None:
            declaring = next(base for base in model.__mro__ if name in inspect.get_annotations(base))
            field.description = _docstrings(declaring).get(name)
    return model.model_fields


@cache
def _docstrings(model: type) -> dict[str, str]:
    """Return the docstrings below the fields that a class itself declares, by name."""
    (declared,) = ast.parse(dedent(inspect.getsource(model))).body
    found = {}
    for field, below in pairwise(declared.body if isinstance(declared, ast.ClassDef) else []):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            text = below.value if isinstance(below, ast.Expr) else None
            if isinstance(text, ast.Constant) and isinstance(text.value, str):
                found[field.target.id] = inspect.cleandoc(text.value)
    return found
