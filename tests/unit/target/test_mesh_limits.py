"""Sizes of mesh files: what is too large is refused before it takes memory, also in a header."""

import json
import os
import struct
import tracemalloc
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rpod_target import Target, TargetError, load_target
from rpod_target.drafting.draft import DraftOptions, draft
from rpod_target.mesh.files import read_mesh_file
from rpod_target.mesh.folder import read_files, surface_m

MB = 1_000_000
CORNERS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
FACET = b"\0" * 12 + CORNERS + b"\0\0"


def stl(triangles: int) -> bytes:
    return b"\0" * 80 + struct.pack("<I", triangles) + triangles * FACET


@contextmanager
def little_memory(most_bytes: int = 20 * MB) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most_bytes
    finally:
        tracemalloc.stop()


@pytest.fixture
def huge(tmp_path: Path) -> Path:
    """Return a file of 800 MB that takes no space on the disk."""
    file = tmp_path / "huge.stl"
    file.touch()
    os.truncate(file, 800 * MB)
    return file


# ---- files


def test_a_file_that_is_too_large_is_refused_before_it_is_read(
    build: Callable[..., Target], huge: Path
) -> None:
    part = {"shape": "mesh", "file": huge.name, "metres_per_unit": 1.0}
    reason = (
        r"parts\.0\.file: huge\.stl has 800 MB, at most 500 MB are read: simplify it, or raise the limit "
        r"\(largest_file_mb: 800\)"
    )
    with little_memory(), pytest.raises(TargetError, match=reason):
        build(part)


def test_a_draft_and_the_surroundings_have_the_same_limit(tmp_path: Path, huge: Path) -> None:
    with little_memory(), pytest.raises(TargetError, match=r"has 800 MB.*\(--largest-file-mb 800\)"):
        draft(huge, tmp_path / "huge.yaml", DraftOptions(units="m"))
    with (
        little_memory(),
        pytest.raises(ValueError, match=r"has 800 MB, at most 500 MB are read: simplify it$"),
    ):
        surface_m(huge, 1.0)


def test_the_limit_counts_the_files_that_are_read_with_it(tmp_path: Path, huge: Path) -> None:
    (tmp_path / "hull.obj").write_text(f"mtllib {huge.name}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with little_memory(), pytest.raises(ValueError, match=r"has 801 MB with huge\.stl, at most 500 MB"):
        read_files(tmp_path / "hull.obj")


def test_what_has_no_end_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "zeros.stl").symlink_to("/dev/zero")
    with pytest.raises(OSError, match="is no regular file"):
        read_files(tmp_path / "zeros.stl")
    (tmp_path / "without-a-size.stl").symlink_to("/proc/self/smaps")
    with pytest.raises(ValueError, match=r"at most 0\.001 MB are read"):
        read_files(tmp_path / "without-a-size.stl", largest_mb=0.001)


def test_a_limit_that_was_raised_holds_and_gives_the_same_target(
    document: dict[str, Any], write: Callable[[dict[str, Any]], Path], cache: Path, tmp_path: Path
) -> None:
    (tmp_path / "sheet.stl").write_bytes(stl(20))  # 1,084 bytes
    part = {"name": "s", "material": "paint", "shape": "mesh", "file": "sheet.stl", "longest_side_m": 1.0}

    def loaded(**fields: float) -> Target:
        return load_target(write(document | {"parts": [part | fields]}), cache=cache)

    with pytest.raises(TargetError, match=r"at most 0\.001 MB are read"):
        loaded(largest_file_mb=0.001)
    as_it_was, raised = loaded(), loaded(largest_file_mb=600.0)
    assert (raised.triangles_m == as_it_was.triangles_m).all()
    assert raised.content == as_it_was.content, "of the same file of the cache"


# ---- headers


def gltf(
    *accessors: dict[str, Any], size: int = 64, view: dict[str, int] | None = None, copies: int = 1
) -> bytes:
    """Return a document of one buffer, one view of it, arrays, and copies of a surface of the first one."""
    uri = "data:;base64," + b64encode(bytes(size)).decode()
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": size, "uri": uri}],
            "bufferViews": [{"buffer": 0, "byteLength": size} | (view or {})],
            "accessors": [{"componentType": 5126, "count": 3, "type": "VEC3"} | each for each in accessors],
            "meshes": [{"primitives": copies * [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }
    ).encode()


MANY = 4_000_000_000
SPARSE = {
    "count": 1,
    "indices": {"bufferView": 0, "componentType": 5125},
    "values": {"bufferView": 0},
}
PLACE = b"property float x\nproperty float y\nproperty float z\n"
PLY = b"ply\nformat %s 1.0\nelement vertex %d\n" + PLACE + b"%send_header\n"
FACES = b"element face %d\nproperty list %s int vertex_indices\n"
HOSTILE = {
    "triangles of an STL": (
        "a.stl",
        b"\0" * 80 + struct.pack("<I", MANY) + FACET,
        "ends after 1 of 4000000000",
    ),
    "corners of a PLY": ("a.ply", PLY % (b"binary_little_endian", MANY, b"") + CORNERS, "unexpected length"),
    "faces of a PLY": (
        "a.ply",
        PLY % (b"binary_little_endian", 3, FACES % (MANY, b"uchar")) + CORNERS + b"\3" + bytes(12),
        "unexpected length",
    ),
    "corners of a face": (
        "a.ply",
        PLY % (b"binary_little_endian", 3, FACES % (1, b"uint")) + CORNERS + b"\xff" * 20,
        "cannot be read as PLY",
    ),
    "text of a PLY": ("a.ply", PLY % (b"ascii", MANY, b"") + b"0 0 0\n" * 3, "3 points and no face"),
    "corners of an OFF": ("a.off", b"OFF\n%d %d 0\n0 0 0\n" % (MANY, MANY), "ends before its 4000000000"),
    "an array without bytes": (
        "a.gltf",
        gltf({"count": MANY}),
        "announces 4000000000 values that are not in it",
    ),
    "a count that is no integer": (
        "a.gltf",
        gltf({"count": float(MANY), "sparse": SPARSE}),
        "announces an array of 4000000000.0 values",
    ),
    "a negative count": (
        "a.gltf",
        gltf({"count": MANY}, {"count": -MANY}),
        "announces an array of -4000000000",
    ),
    "a stride of zero": (
        "a.gltf",
        gltf({"bufferView": 0, "count": 29 * MB, "sparse": SPARSE}, view={"byteStride": 0}),
        "12 bytes that are 0 bytes apart",
    ),
    "arrays over the same bytes": (
        "a.gltf",
        gltf(*1000 * [{"bufferView": 0, "count": MB // 10}], size=MB // 10 + 11, view={"byteStride": 1}),
        "announces 1200000000 bytes in its arrays, at most 500000000",
    ),
    "surfaces of the same corners": (
        "a.gltf",
        gltf({"bufferView": 0, "count": 30_000}, size=360_000, copies=1_001),
        "announces 10010000 triangles, at most 10000000",
    ),
}


@pytest.mark.parametrize(("name", "content", "reason"), HOSTILE.values(), ids=HOSTILE.keys())
def test_a_header_that_announces_too_much_takes_no_memory(name: str, content: bytes, reason: str) -> None:
    read_mesh_file("warm.stl", stl(1), {})  # the reader's own import
    with little_memory(), pytest.raises(ValueError, match=reason):
        read_mesh_file(name, content, {})
