"""Polygons of OBJ files: concave ones, straight corners, negative indices, lines that go on."""

import numpy as np
import pytest

from rpod_target.mesh.files import read_mesh_file
from rpod_target.mesh.polygons import concave, triangulated
from rpod_target.mesh.topology import areas_m2, open_edges, volume_m3

L = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
"""An L with an area of 5, whose fan from its first corner is right; from the third it is not."""


def prism(outline: list[tuple[float, float]], *, first: int = 0, negative: bool = False) -> str:
    """Return the OBJ text of an upright prism of height 1, its ends as polygons that begin at a corner."""
    count = len(outline)
    turned = outline[first:] + outline[:first]
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in turned]

    def face(*corners: int) -> str:
        return "f " + " ".join(str(c - 2 * count if negative else c + 1) for c in corners)

    lines += [face(*range(count - 1, -1, -1)), face(*range(count, 2 * count))]
    lines += [face(c, (c + 1) % count, count + (c + 1) % count, count + c) for c in range(count)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("first", range(6))
def test_a_concave_polygon_covers_its_own_area_only(first: int) -> None:
    triangles = read_mesh_file("l.obj", prism(L, first=first).encode(), {}).triangles
    assert open_edges(triangles) == 0
    assert volume_m3(triangles) == pytest.approx(5.0)
    assert areas_m2(triangles).sum() == pytest.approx(2 * 5.0 + 12.0)


def test_corners_on_a_straight_side_stay_so_that_the_surface_stays_closed() -> None:
    outline = [(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3), (0, 2), (0, 1)]
    triangles = read_mesh_file("l.obj", prism(outline).encode(), {}).triangles
    assert open_edges(triangles) == 0
    assert areas_m2(triangles).sum() == pytest.approx(2 * 5.0 + 12.0)


def test_indices_from_the_end_count_back_from_their_own_line() -> None:
    text = "o one\n" + prism(L, negative=True) + "o two\n" + prism([(5, 5), (6, 5), (6, 6)], negative=True)
    mesh = read_mesh_file("two.obj", text.encode(), {})
    assert set(mesh.objects) == {"one", "two"}
    assert volume_m3(mesh.triangles) == pytest.approx(5.5)
    assert open_edges(mesh.triangles) == 0


def test_a_line_may_go_on_after_a_backslash() -> None:
    text = prism(L).replace("f 6 5 4 3", "f 6/1/1 5/1/1 \\\n 4/1/1 3/1/1")
    assert "\\" in text
    assert volume_m3(read_mesh_file("l.obj", text.encode(), {}).triangles) == pytest.approx(5.0)


def test_a_corner_that_is_not_there_is_told() -> None:
    with pytest.raises(ValueError, match="a corner that is not in the file"):
        read_mesh_file("l.obj", (prism(L) + "f 1 2 3 99\n").encode(), {})


@pytest.mark.parametrize("tilt", [(0, 0, 1), (1, 0, 0), (0.3, -0.9, 0.2)])
def test_triangles_face_as_their_polygon_does(tilt: tuple[float, float, float]) -> None:
    x = np.cross(tilt, (0.1, 0.2, 0.7))
    x /= np.linalg.norm(x)
    y = np.cross(tilt, x) / np.linalg.norm(tilt)
    corners = np.array(L) @ np.stack([x, y])
    assert concave(corners[None])[0]
    for way in (corners, corners[::-1]):
        triangles = way[triangulated(way)]
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        newell = np.cross(way, np.roll(way, -1, axis=0)).sum(axis=0)
        assert (normals @ newell > 0.0).all()
        assert areas_m2(triangles).sum() == pytest.approx(5.0)
        assert len(triangles) == 4


def test_a_convex_polygon_is_not_concave() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0.3 * np.cos(angle)], axis=1)
    assert not concave(np.stack([ring, ring[::-1]])).any()


def test_a_polygon_that_cuts_through_itself_keeps_its_corners() -> None:
    bow = np.array([(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0), (0, 0.5, 0)], float)
    assert set(triangulated(bow).ravel()) == {0, 1, 2, 3, 4}
