"""Texts for operators: what those have in common that differ only in their figures."""

import re

_FIGURE = re.compile(r"(?<![A-Za-z])-?\d+(\.\d+)?(e-?\d+)?")


def without_figures(text: str) -> str:
    """Return a text with an ellipsis in place of each number, so that texts of one kind are equal."""
    return _FIGURE.sub("…", text)


def shown(text: str, longest: int = 1000) -> str:
    """Return a text of others for a log line or a terminal: one line, shortened, without control characters.

    Otherwise anybody on the bus could write lines of his own into a log, or hide those of others.
    """
    short = text if len(text) <= longest else f"{text[:longest]}…"
    return short if short.isprintable() else "".join(c if c.isprintable() else "�" for c in short)


def is_count(text: str) -> bool:
    """Return whether a text is a count that a service may have: at most 20 digits, those of 64 bits."""
    return text.isdecimal() and len(text) <= 20
