"""Tables that are computed once and kept beside the built targets: a restart does not compute them again.

The name of a file is a digest of the table's inputs, so that other inputs have another file. Like the
targets, the files may be deleted at any time.
"""

import contextlib
import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np

from rpod_schemas.arrays import Array
from rpod_schemas.caches.folder import cache_folder
from rpod_target import cache as store
from rpod_target.target import Target

Tables = dict[str, Array]


def kept(name: str, version: int, inputs: tuple[Any, ...], make: Callable[[], Tables]) -> Tables:
    """Return tables by name from the cache, or compute them and keep them there.

    Args:
        name: what they are, for the name of their file.
        version: to be increased when the same inputs give other tables.
        inputs: everything that determines them: arrays, numbers and texts.
        make: function that computes them.
    """
    content = hashlib.sha256(f"{name} {version}".encode())
    for each in inputs:
        array = np.ascontiguousarray(each)
        content.update(f" {array.dtype.str} {array.shape} ".encode())
        content.update(array.tobytes())
    file = cache_folder() / f"table-{name}-{content.hexdigest()}.npz"
    found = store.read(file)
    if found is not None:
        del found[store.DIGEST]
        return found
    made = make()
    with contextlib.suppress(OSError):  # with a full or read-only disk only the next start is slower
        store.write(file, store.with_digest(made))
    return made


def kept_of(
    target: Target, name: str, version: int, inputs: tuple[Any, ...], make: Callable[[], Tables]
) -> Tables:
    """Return tables of a target as ``kept`` does; those of a target that is not from a file are not kept.

    A target with joints has another shape at each angle: its tables would fill the disk.
    """
    return kept(name, version, inputs, make) if target.content else make()
