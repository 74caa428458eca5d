"""Texts for operators: those that differ only in their figures, those of others, and the system's errors."""

import errno
import re

_FIGURE = re.compile(r"(?<![A-Za-z])-?\d+(\.\d+)?(e-?\d+)?")


_REMEDIES = {
    errno.ENOSPC: "free space on the disk, or {other}",
    errno.EDQUOT: "free space in the quota, or {other}",
    errno.EFBIG: "raise the limit of the file size",
    errno.EROFS: "make the folder writable, or {other}",
    errno.EACCES: "ask for the right to it, or {other}",
    errno.EPERM: "ask for the right to it, or {other}",
    errno.EEXIST: "a file is in the place of a folder: move it away, or {other}",
    errno.ENOTDIR: "a file is in the place of a folder: move it away, or {other}",
    errno.EISDIR: "it is a folder: give the path of a file",
    errno.ENOENT: "check its spelling",
}
"""What to do after an error of the operating system, by its number."""


def remedy_of(error: OSError, other: str = "give another path") -> str:
    """Return what to do after an error of the operating system; empty if no remedy is known.

    Args:
        error: the error.
        other: what else helps where a file or folder cannot be used.
    """
    return _REMEDIES.get(error.errno or 0, "").format(other=other)


def reason_of(error: OSError) -> str:
    """Return an error of the operating system in words, with the remedy, without its number and path."""
    return "; ".join(filter(None, ((error.strerror or str(error)).lower(), remedy_of(error))))


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
