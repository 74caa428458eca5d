"""STL files, binary and text."""

import numpy as np
import pytest

from rpod_target.stl import read_stl

TRIANGLES = np.array(
    [
        [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 2.0, 0.0]],
        [[0.0, 0.0, 1.0], [1e-3, 0.0, 1.0], [0.0, -2.0, 1.0]],
    ]
)


def as_text(triangles: np.ndarray) -> bytes:
    facets = [
        "facet normal 0 0 1\n outer loop\n"
        + "".join(f"  vertex {x:e} {y:e} {z:e}\n" for x, y, z in triangle)
        + " endloop\nendfacet\n"
        for triangle in triangles
    ]
    return ("solid piece\n" + "".join(facets) + "endsolid piece\n").encode()


def as_binary(triangles: np.ndarray, header: bytes) -> bytes:
    records = np.zeros(len(triangles), [("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    records["c"] = triangles
    return header.ljust(80) + len(triangles).to_bytes(4, "little") + records.tobytes()


@pytest.mark.parametrize(
    "content",
    [as_text(TRIANGLES), as_binary(TRIANGLES, b"exported"), as_binary(TRIANGLES, b"solid by mistake")],
    ids=["text", "binary", "binary that begins like text"],
)
def test_both_forms_are_read(content: bytes) -> None:
    np.testing.assert_allclose(read_stl(content), TRIANGLES, rtol=1e-6)


def test_triangles_without_area_are_dropped() -> None:
    flat = np.concatenate([TRIANGLES, np.ones((1, 3, 3))])
    assert len(read_stl(as_binary(flat, b""))) == 2


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "neither"),
        (b"ISO-10303-21; a STEP file", "neither"),
        (as_binary(TRIANGLES, b"")[:-1], "neither"),
        (as_text(TRIANGLES)[:150], "neither"),
        (b"solid nothing\nendsolid nothing\n", "no triangle"),
        (as_binary(np.zeros((2, 3, 3)), b""), "no triangle"),
        (as_binary(TRIANGLES * np.nan, b""), "not finite"),
        (b"solid x\nvertex a b c\nvertex 1 2 3\nvertex 1 2 3\n", "not a number"),
    ],
)
def test_what_is_no_usable_stl_file_is_refused_with_a_reason(content: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_stl(content)
