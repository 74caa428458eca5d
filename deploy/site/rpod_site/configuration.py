"""Writes the configuration reference from the pydantic models: a table a model, a page a module.

Tuning models stand on a page of their own, with the provenance of each value.
"""

import importlib
import inspect
import pkgutil
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import get_type_hints

from annotated_types import MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from rpod_schemas.config.base import Config
from rpod_schemas.config.tuning import Tuning, provenance_of
from rpod_site.field_types import bounds, default_text, type_text
from rpod_site.sentences import described

_INDEX = """# Configuration

Every service reads one model from a file in YAML, TOML or JSON (`rpod estimator --config FILE`). A scenario
holds what the services share. An unknown field or a value out of bounds is refused with its name and the
reason. A field without a default must be given. The tables are made from the models in the code.

What stands under `tuning` is no part of the promise: it may change with any version. It has a page of its
own, which says where each value comes from.

| page | models |
|---|---|
"""


def write(folder: Path) -> None:
    """Write the pages."""
    folder.mkdir(parents=True, exist_ok=True)
    pages: dict[str, list[type[BaseModel]]] = defaultdict(list)
    for model in models():
        pages[Tuning.__module__ if issubclass(model, Tuning) else model.__module__].append(model)
    where = {model: f"{_file(module)}#{_anchor(model)}" for module, of in pages.items() for model in of}
    index = [_INDEX.rstrip()]
    for module, of in sorted(pages.items(), key=lambda page: _file(page[0])):
        (folder / _file(module)).write_text(_page(module, of, where), "utf-8")
        index.append(
            f"| [{_title(module)}]({_file(module)}) | {', '.join(f'`{model.__name__}`' for model in of)} |"
        )
    (folder / "index.md").write_text("\n".join(index) + "\n", "utf-8")


def models() -> list[type[BaseModel]]:
    """Return every configuration model of the project, its fields described, in the order of its source."""
    for package in {name.partition(".")[0] for name in _modules()}:
        importlib.import_module(package)
    for name in _modules():
        importlib.import_module(name)
    found = [model for model in _below(Config) if not model.__name__.startswith("_")]
    for model in found:
        described(model)
    return sorted(set(found), key=lambda model: (model.__module__, inspect.getsourcelines(model)[1]))


def _modules() -> Iterator[str]:
    """Yield the modules of all installed packages of the project, but not its programs."""
    packages = [
        package.name
        for package in pkgutil.iter_modules()
        if re.fullmatch(r"rpod(_(?!site)\w+)?", package.name)
    ]
    for package in packages:
        path = importlib.import_module(package).__path__
        for module in pkgutil.walk_packages(path, f"{package}."):
            if not module.name.endswith("__main__") and ".examples" not in module.name:
                yield module.name


def _below(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for child in model.__subclasses__():
        yield child
        yield from _below(child)


def _page(module: str, of: list[type[BaseModel]], where: dict[type[BaseModel], str]) -> str:
    doc = inspect.getdoc(importlib.import_module(module)) or ""
    parts = [f"# {_title(module)}", doc, *(_section(model, where) for model in of)]
    return "\n\n".join(parts) + "\n"


def _section(model: type[BaseModel], where: dict[type[BaseModel], str]) -> str:
    lines = [f"## {model.__name__} {{ #{_anchor(model)} }}", "", inspect.getdoc(model) or "", ""]
    heads = ["field", "type", "default", "bounds", "meaning"]
    if issubclass(model, Tuning):
        heads.append("provenance")
    if model.model_fields:
        lines += [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    hints = get_type_hints(model, include_extras=True)
    for name, field in model.model_fields.items():
        row = _row(name, field, where)
        lines.append(f"{row} {_provenance(hints[name])} |" if issubclass(model, Tuning) else row)
    return "\n".join(lines)


def _provenance(annotation: object) -> str:
    found = provenance_of(annotation)
    return f"{found.source}: {found.note}" if found else "as the field that holds it, or its own fields"


def _row(name: str, field: FieldInfo, where: dict[type[BaseModel], str]) -> str:
    cells = (
        f"`{name}`",
        type_text(field.rebuild_annotation(), where),
        _default_cell(field, where),
        bounds(field),
        meaning(name, field),
    )
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def meaning(name: str, field: FieldInfo) -> str:
    """Return the sentence of a field; ``kind`` has the same one in every model that has none."""
    if field.description:
        return " ".join(field.description.split())
    return "Selects this model where several may stand." if name == "kind" else ""


def _default_cell(field: FieldInfo, where: dict[type[BaseModel], str]) -> str:
    """Return a field's default; its sentence explains an empty list that a file itself may not have."""
    if field.is_required():
        return "required"
    value = _default(field)
    needs_items = any(isinstance(rule, MinLen) and rule.min_length > 0 for rule in field.metadata)
    return "see meaning" if needs_items and value == () else default_text(value, where)


def _default(field: FieldInfo) -> object:
    if field.default is not PydanticUndefined:
        return field.default
    return field.get_default(call_default_factory=True, validated_data={})


def _file(module: str) -> str:
    return f"{_title(module).replace(' ', '-')}.md"


def _title(module: str) -> str:
    """Return a page's name: the module's within the configuration, else the package's before it."""
    parts = module.removeprefix("rpod_schemas.config.").removeprefix("rpod_").split(".")
    return " ".join(dict.fromkeys(part.replace("_", " ") for part in parts))


def _anchor(model: type[BaseModel]) -> str:
    return model.__name__.lower()
