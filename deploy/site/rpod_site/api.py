"""Writes one page of the API reference for each package, with every public module in it."""

from collections.abc import Iterator
from pathlib import Path

_BEHIND_OTHERS = "---\nsearch:\n  boost: 0.2\n---"
"""In search results, behind the pages that explain."""
SOURCES = ("services", "schemas", "sim_sensor")


def write(root: Path, folder: Path) -> None:
    """Write the pages; mkdocstrings fills them from the code."""
    folder.mkdir(parents=True, exist_ok=True)
    for package, directory in sorted(packages(root)):
        (folder / f"{package}.md").write_text(_page(package, directory), "utf-8")


def packages(root: Path) -> Iterator[tuple[str, Path]]:
    """Yield the name and the folder of each package that holds Python modules, those within packages too."""
    for source in SOURCES:
        for file in (root / source).rglob("__init__.py"):
            if modules(file.parent) or file.stat().st_size:
                yield ".".join(file.parent.relative_to(root / source).parts), file.parent


def modules(directory: Path) -> list[str]:
    """Return the names of a package's public modules."""
    return sorted(file.stem for file in directory.glob("*.py") if not file.stem.startswith("_"))


def _page(package: str, directory: Path) -> str:
    parts = [_BEHIND_OTHERS, f"# {package}", _block(package, level=2, members=False)]
    parts += [_block(f"{package}.{module}", level=2) for module in modules(directory)]
    return "\n\n".join(parts) + "\n"


def _block(name: str, *, level: int, members: bool = True) -> str:
    lines = [f"::: {name}", "    options:", f"      heading_level: {level}"]
    if not members:
        lines += ["      members: false", "      show_root_heading: false"]
    return "\n".join(lines)
