"""Texts of mesh files, and the names of files in them, as programs of other systems write them."""

import codecs
from pathlib import PurePosixPath, PureWindowsPath
from urllib.parse import unquote

_MARKS = {  # the longest first, since the mark of UTF-16 begins that of UTF-32
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
"""Encodings by the bytes that mark them at the beginning of a text."""


def as_utf8(content: bytes) -> bytes:
    """Return a text whose first bytes mark its encoding as UTF-8 without a mark; other bytes as they are."""
    for mark, encoding in _MARKS.items():
        if content.startswith(mark):
            try:
                return content.decode(encoding).encode()
            except UnicodeError:
                return content  # no text
    return content


def with_line_feeds(content: bytes) -> bytes:
    """Return a text whose lines end with a carriage return alone as one whose lines end with a line feed."""
    return content if b"\n" in content else content.replace(b"\r", b"\n")


def local_name(written: str) -> str:
    """Return the name of a file beside another one, as that file may state it.

    It may be in quotation marks, begin with ``./`` or separate folders as Windows does. Of an absolute path
    only the last part counts, since it is one of the computer on which the file was written.
    """
    written = written.strip().strip('"')
    path = PurePosixPath(written.replace("\\", "/"))
    return path.name if path.is_absolute() or PureWindowsPath(written).anchor else str(path)


def file_of(uri: str) -> str:
    """Return the name of the file that a glTF document refers to, whose spaces may be written as ``%20``."""
    return local_name(unquote(uri))
