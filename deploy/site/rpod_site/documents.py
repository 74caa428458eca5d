"""Copies the repository's documents, and the files that they link to, into the site's pages."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from markdown_it import MarkdownIt

_DECISIONS = Path("docs") / "decisions"


def tracked(root: Path) -> list[Path]:
    """Return the Markdown documents of the repository, relative to its root.

    Tests keep documents of their own, which are no part of the site.
    """
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    paths = sorted(Path(line) for line in listed.stdout.splitlines())
    return [path for path in paths if path.parts[0] != "tests" and (root / path).is_file()]


def stage(root: Path, pages: Path) -> None:
    """Copy documents and what they link to; a link to a folder or notebook becomes one to its page."""
    for document in tracked(root):
        text = (root / document).read_text("utf-8")
        for link in set(links(text)):
            target = (root / document.parent / link).resolve()
            if target.is_dir():
                text = text.replace(f"]({link})", f"]({link.rstrip('/')}/{_first_page(target)})")
            elif target.suffix == ".ipynb":
                text = text.replace(f"]({link})", f"]({link.removesuffix('.ipynb')}.md)")
            elif target.is_file() and target.is_relative_to(root) and target.suffix != ".md":
                _copy(target, pages / target.relative_to(root))
        _write(pages / document, text)
    _write(pages / _DECISIONS / "index.md", _decisions(root))


def links(text: str) -> Iterator[str]:
    """Yield the links and images of a Markdown text that lead to files, without their anchors."""
    for token in MarkdownIt("commonmark").enable("table").parse(text):
        for child in token.children or ():
            link = child.attrGet("href") or child.attrGet("src")
            path = unquote(str(link)).split("#")[0] if link else ""
            if path and not re.match(r"[a-z]+:", path):
                yield path


def heading(text: str) -> str:
    """Return the first heading of a Markdown text."""
    found = re.search(r"^# (.+)$", text, re.MULTILINE)
    return found[1].replace("`", "") if found else ""


def _first_page(folder: Path) -> str:
    return "README.md" if (folder / "README.md").is_file() else "index.md"


def _decisions(root: Path) -> str:
    lines = ["# Decisions", "", "Each decision has context, decision and consequences.", ""]
    files = sorted((root / _DECISIONS).glob("[0-9]*.md"))
    lines += [f"- [{heading(file.read_text('utf-8'))}]({file.name})" for file in files]
    return "\n".join(lines) + "\n"


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def _write(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, "utf-8")
