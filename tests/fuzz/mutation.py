"""Hostile bytes and documents made of valid ones: of CDR messages field by field, of any bytes, of JSON.

All randomness comes from a ``random.Random``. Hypothesis has one that it can shrink (``st.randoms``), and the
long runs have a seeded one.
"""

import json
import math
import struct
from copy import deepcopy
from dataclasses import fields, is_dataclass
from random import Random
from typing import Any

import numpy as np

from rpod_schemas.rmw.cdr import decode, encode

NUMBERS: tuple[float, ...] = (
    0, 1, -1, 2, 255, 2**16, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, -(2**63), 2**64,
    -0.0, 5e-324, 1e-300, 1e-30, 1e-9, 1e30, 1e308, -1e308, math.inf, -math.inf, math.nan,
)  # fmt: skip
TEXTS = (
    "",
    "\x00",
    "a" * 70_000,
    "../../x",
    "<script>alert(1)</script>",
    "é\U0001f6f0",
    "*",
    "a/b",
    "nan",
    "1e999",
)
_LENGTHS = 0, 1, 4, 8, 100, 5000
_WORDS = tuple(struct.pack("<I", word) for word in (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7FC00000))
_HEAD = 600
"""Bytes at the beginning of a message in which its sizes and names stand."""


def mutate_bytes(rnd: Random, base: bytes) -> bytes:
    """Return bytes with one to three changes: flipped, cut, overwritten, inserted or repeated."""
    data = bytearray(base)
    for _ in range(rnd.randint(1, 3)):
        _change_bytes(rnd, data)
    return bytes(data)


def _change_bytes(rnd: Random, data: bytearray) -> None:
    kind, at = (
        rnd.randrange(6),
        rnd.randrange(min(len(data), _HEAD) + 1) if rnd.randrange(4) else rnd.randrange(len(data) + 1),
    )
    if kind == 0 and at < len(data):
        data[at] ^= 1 << rnd.randrange(8)
    elif kind == 1:
        del data[at:]
    elif kind == 2:
        data[at & ~3 : (at & ~3) + 4] = rnd.choice(_WORDS)
    elif kind == 3:
        data[at & ~3 : (at & ~3) + 8] = struct.pack("<d", _number(rnd))
    elif kind == 4:
        data[at:at] = rnd.randbytes(rnd.choice(_LENGTHS))
    else:
        data[at:at] = data[at : at + rnd.choice(_LENGTHS)]


def mutate_message(rnd: Random, base: bytes, type_name: str) -> bytes:
    """Return the bytes of a message with hostile values in one to three of its fields, or hostile bytes."""
    if rnd.randrange(3) == 0:
        return mutate_bytes(rnd, base)
    message = deepcopy(decode(base, type_name))
    for _ in range(rnd.randint(1, 3)):
        _change_field(rnd, message)
    try:
        return bytes(encode(message))
    except Exception:  # noqa: BLE001 - a value that its field cannot hold
        return mutate_bytes(rnd, base)


def _change_field(rnd: Random, message: Any) -> None:
    """Walk to a field and replace its value."""
    while True:
        name = rnd.choice([each.name for each in fields(message) if each.name != "__msgtype__"])
        value = getattr(message, name)
        if isinstance(value, list) and value and is_dataclass(value[0]) and rnd.randrange(3):
            message = rnd.choice(value)
        elif is_dataclass(value):
            message = value
        else:
            setattr(message, name, _hostile(rnd, value))
            return


def _hostile(rnd: Random, value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _hostile_array(rnd, value)
    if isinstance(value, str):
        return rnd.choice(TEXTS)
    if isinstance(value, list):
        return rnd.choice(([], value[:1], value * 2, (value * 300)[:300]))
    if isinstance(value, bool):
        return not value
    return _number(rnd) if isinstance(value, float) else _integer(rnd)


def _hostile_array(rnd: Random, value: np.ndarray) -> np.ndarray:
    kind = rnd.randrange(5)
    if kind == 0:
        return value[: rnd.randrange(len(value) + 1)].copy()
    if kind == 1:
        return np.resize(value, rnd.choice(_LENGTHS))
    changed = value.copy()
    if changed.size:
        places = [rnd.randrange(changed.size) for _ in range(rnd.choice((1, 3, 50)))]
        with np.errstate(all="ignore"):
            changed.flat[places] = np.array(_number(rnd)).astype(changed.dtype)
    return changed


def _number(rnd: Random) -> float:
    value = float(rnd.choice(NUMBERS)) if rnd.randrange(4) else rnd.uniform(-10.0, 10.0)
    return value if rnd.randrange(5) else value * rnd.uniform(-2.0, 2.0)


def _integer(rnd: Random) -> int:
    return (
        int(rnd.choice([value for value in NUMBERS if math.isfinite(value)]))
        if rnd.randrange(4)
        else rnd.randrange(300)
    )


def mutate_document(rnd: Random, base: Any) -> Any:
    """Return a document of dictionaries and lists with one to three hostile values, keys or sizes."""
    document = deepcopy(base)
    for _ in range(rnd.randint(1, 3)):
        _change_document(rnd, document)
    return document


def _change_document(rnd: Random, node: Any) -> None:
    while isinstance(node, dict | list) and node:
        key: Any = rnd.choice(list(node)) if isinstance(node, dict) else rnd.randrange(len(node))
        if isinstance(node[key], dict | list) and node[key] and rnd.randrange(4):
            node = node[key]
            continue
        kind = rnd.randrange(8)
        if kind == 0:
            del node[key]
        elif kind == 1 and isinstance(node, dict):
            node[rnd.choice(TEXTS)] = node[key]
        elif kind == 2:
            node[key] = _nested(rnd.choice((2, 50, 400)))
        else:
            node[key] = rnd.choice(
                (None, True, [], {}, _number(rnd), _integer(rnd), rnd.choice(TEXTS), [node[key]] * 3)
            )
        return


def _nested(depth: int) -> Any:
    node: Any = 1
    for _ in range(depth):
        node = [node]
    return node


def json_of(rnd: Random, document: Any) -> bytes:
    """Return a document as JSON, sometimes damaged."""
    data = json.dumps(document).encode()
    return data if rnd.randrange(4) else mutate_bytes(rnd, data)
