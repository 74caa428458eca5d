"""Makes the built site independent of a network, and tells what would still be loaded."""

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

_SHIM = re.compile(r'"https://unpkg\.com/iframe-worker/shim"')
"""Material's search needs it where a page is opened from a disk; it would be loaded from a server."""
_SHIM_ELSEWHERE = re.compile(r"https?://[^\s\"']*/iframe-worker[^\s\"']*")
"""The same under an address that ``_SHIM`` does not know: that of another version of Material."""
_INDEX = "search/search_index.js"
"""Index of the search in the form that a page from a disk can load."""
_LOADED = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*?\bsrc\s*=\s*["']?((?:https?:)?//[^"'\s>]+)"""
    r"""|<link\b(?=[^>]*\brel\s*=\s*["']?(?:stylesheet|preload|preconnect|icon))[^>]*?\bhref\s*=\s*["']?((?:https?:)?//[^"'\s>]+)"""
)
_IN_STYLE = re.compile(r"""(?:url\(|@import\s+)["']?((?:https?:)?//[^"')\s]+)""")


def make(site: Path, shim: Path) -> list[tuple[Path, str]]:
    """Put the shim beside the pages; return what still loads from a network: file and address."""
    local = site / "assets" / "javascripts" / shim.name
    shutil.copyfile(shim, local)
    for page in site.rglob("*.html"):
        path = Path(os.path.relpath(local, page.parent)).as_posix()
        page.write_text(_SHIM.sub(f'"{path}"', page.read_text("utf-8")), "utf-8")
    return sorted(_outside(site))


def is_searchable(site: Path) -> bool:
    """Return whether the search of the built site works without a server."""
    return (site / _INDEX).is_file()


def _outside(site: Path) -> Iterator[tuple[Path, str]]:
    for page in site.rglob("*.html"):
        text = page.read_text("utf-8")
        for script, style in _LOADED.findall(text):
            yield page.relative_to(site), script or style
        for shim in _SHIM_ELSEWHERE.findall(text):
            yield page.relative_to(site), shim
    for style_file in site.rglob("*.css"):
        for address in _IN_STYLE.findall(style_file.read_text("utf-8")):
            yield style_file.relative_to(site), address
