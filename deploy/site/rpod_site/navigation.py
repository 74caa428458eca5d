"""Replaces the patterns in the site's navigation by the pages that are there."""

from pathlib import Path
from typing import Any

import yaml

from rpod_site.documents import heading


class UnknownPageError(Exception):
    """An entry of the navigation that stands for no page."""

    def __init__(self, pattern: str) -> None:
        super().__init__(f"mkdocs.yml: nav: {pattern!r} stands for no page; correct or remove it")


def write(template: Path, file: Path, pages: Path) -> None:
    """Write the configuration of the site. Raises ``UnknownPageError``."""
    site = yaml.safe_load(template.read_text("utf-8"))
    site["nav"] = [entry for item in site["nav"] for entry in _expand(item, pages)]
    file.write_text(yaml.safe_dump(site, sort_keys=False), "utf-8")


def _expand(item: Any, pages: Path) -> list[Any]:
    if isinstance(item, dict):
        ((title, content),) = item.items()
        if isinstance(content, str) and "*" not in content:
            return [{title: content}]
        listed = content if isinstance(content, list) else [content]
        return [{title: [entry for each in listed for entry in _expand(each, pages)]}]
    found = sorted(pages.glob(item), key=lambda page: (page.name != "index.md", page))
    if not found:
        raise UnknownPageError(item)
    return [_entry(page, pages) for page in found]


def _entry(page: Path, pages: Path) -> str | dict[str, str]:
    path = page.relative_to(pages).as_posix()
    if page.name == "index.md":
        return path  # the page of a section has no entry of its own
    return {_title(page): path}


def _title(page: Path) -> str:
    """Return a short title: a package's name, or the first heading."""
    title = heading(page.read_text("utf-8")) or page.parent.name
    return title.split(":")[0] if page.name == "README.md" else title
