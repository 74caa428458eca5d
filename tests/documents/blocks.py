"""The code blocks of a Markdown document, with what a comment before each says of it.

A comment stands on the line above the block, ``<!-- kind: text -->`` or ``<!-- kind -->``:

``not run: reason``    the block is left out
``in full``            its runs and campaigns are as long as the document shows
``in the background``  each command is a process that goes on until the document ends, once it is ready
``end the background`` they end here; no block is needed
``output``             the block is what the block before prints; ``...`` stands for anything
``same as: path``      the block is the file at this path beside the document; it is also put into the folder
``given: a.mcap from scenario``  a log of a short run of the scenario is put into the folder; needs no block
``given: folder``      a folder of the repository is put into the folder; needs no block
"""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

_COMMENT = re.compile(r"<!--\s*([a-z ]+?)\s*(?::\s*(.*?))?\s*-->")
_KINDS = ("not run", "in full", "in the background", "output", "same as", "given", "end the background")
_ALONE = ("given", "end the background")


@dataclass(frozen=True)
class Block:
    """A fenced block."""

    document: Path
    line: int
    """Number of its first line of code, from 1."""
    language: str
    """First word after the fence; empty where there is none."""
    title: str
    """The file's name in the folder, from ``title="..."``; empty where the block is no file."""
    kind: str
    """What the comment says; empty where there is none."""
    said: str
    """The comment's text after the colon."""
    text: str

    def __str__(self) -> str:
        return f"{self.document}:{self.line}"


def blocks_of(document: Path) -> Iterator[Block]:
    """Yield the blocks of a document, and its comments that stand for files, in order."""
    kind, said = "", ""
    for token in MarkdownIt("commonmark").parse(document.read_text("utf-8")):
        line = (token.map or [0])[0] + 1
        if token.type == "html_block":
            kind, said = _comment(token.content)
            if kind in _ALONE:
                yield Block(document, line, "", "", kind, said, "")
                kind, said = "", ""
        elif token.type == "fence":
            language, title = _info(token.info)
            yield Block(document, line + 1, language, title, kind, said, token.content)
            kind, said = "", ""
        elif token.nesting >= 0:
            kind, said = "", ""


def _comment(text: str) -> tuple[str, str]:
    found = _COMMENT.fullmatch(text.strip())
    if not found or found[1] not in _KINDS:
        return "", ""
    return found[1], found[2] or ""


def _info(info: str) -> tuple[str, str]:
    words = shlex.split(info)
    titles = [word.partition("=")[2] for word in words[1:] if word.startswith("title=")]
    return (words[0] if words else ""), (titles[0] if titles else "")
