"""Repair of the triangles of a mesh file, in a fixed order: each surface is closed where it can be.

The order, and what each step is for:

1. Corners closer than a millionth of the size are one corner; those of open edges, closer than 1e-4 of
   it.
2. Triangles with two equal corners are left out: no surface is lost.
3. A triangle that occurs several times is kept once. Two that face opposite ways are both kept if the surface
   is closed with them; otherwise one of them is kept.
4. A triangle whose three corners lie on a line is removed by splitting its neighbour there, so that the
   surface stays as closed as it was.
5. Neighbours that run in opposite senses are turned to the same sense, by patches whose edges have two
   triangles.
6. A closed surface that faces inwards is turned outwards.

No triangle is added and no hole is filled, so that sensors see the surfaces of the file and no others. A
surface that is still open after this is called loose; ``rpod_target.visibility`` turns it outwards and finds
what is inside.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.topology import Indices, components, directed_edges, welded
from rpod_target.mesh.unusable import NO_AREA

_ROUNDS = 50
_THIN = 1e-6
"""Height of a triangle, over the size of the mesh, below which its corners lie on a line."""
_GAP = 1e-4
"""Width of a gap between open edges, over the size of the mesh, that is closed."""
_NO_VOLUME = 1e-9
"""Volume, over the cube of a surface's size, below which it has no inside."""


@dataclass(frozen=True, eq=False)
class RepairedMesh:
    """Triangles after the repair, each in one of several separate surfaces."""

    triangles: FloatArray
    """Corners, shape (T, 3, 3), all of an area above zero."""
    corner: Indices
    """Number of each corner, shape (T, 3): equal corners have equal numbers."""
    origin: Indices
    """Index of the triangle of the file that each comes from, shape (T,)."""
    surface: Indices
    """Number of the separate surface of each triangle, shape (T,); surfaces share no corner."""
    patch: Indices
    """Number of the patch of each triangle, shape (T,): within one, all triangles face the same side."""
    open_edges: Indices
    """Edges without an opposite one, of each surface; 0 for a closed one."""
    no_inside: NDArray[np.bool_]
    """Whether a surface is closed but encloses no volume, of each surface."""
    cavity: NDArray[np.bool_]
    """Whether a surface is closed, faces inwards and lies inside of another one, of each surface."""
    told: tuple[str, ...]
    """Repairs, one sentence a step."""

    @property
    def loose(self) -> NDArray[np.bool_]:
        """Whether each triangle belongs to a surface without an inside, shape (T,)."""
        return ((self.open_edges > 0) | self.no_inside)[self.surface]


def repair(triangles: FloatArray) -> RepairedMesh:
    """Return the triangles of a file, shape (T, 3, 3), repaired.

    Raises:
        ValueError: no triangle has an area; the text continues a sentence that begins with the file's name.
    """
    told: list[str] = []
    if not len(triangles) or not np.ptp(triangles, axis=(0, 1)).max() > 0.0:
        raise ValueError(NO_AREA)
    index = welded(triangles)
    corners = np.empty((int(index.max()) + 1, 3))
    corners[index.ravel()[::-1]] = triangles.reshape(-1, 3)[::-1]  # the first of equal corners counts
    exact = triangles
    index, moved = _stitched(index, corners, told)
    origin = np.arange(len(index))
    kept = (index != np.roll(index, -1, axis=1)).all(axis=1)
    _note(told, np.count_nonzero(~kept), "triangles with two equal corners were left out")
    index, origin = index[kept], origin[kept]
    index, origin = _without_doubles(index, origin, corners, told)
    index, origin, split = _without_slivers(index, origin, corners, told)
    split |= moved[origin]
    if not len(index):
        raise ValueError(NO_AREA)
    index, patch = _turned_alike(index, told)
    surface = _surfaces(index)
    mesh = RepairedMesh(
        triangles=_corners_of(index, origin, split, corners=corners, exact=exact),
        corner=index,
        origin=origin,
        surface=surface,
        patch=patch,
        open_edges=_open_edges(index, surface),
        no_inside=np.zeros(int(surface.max()) + 1, bool),
        cavity=np.zeros(int(surface.max()) + 1, bool),
        told=(),
    )
    return _turned_outwards(mesh, told)


def turned(mesh: RepairedMesh, which: NDArray[np.bool_]) -> RepairedMesh:
    """Return a mesh with some triangles, mask of shape (T,), turned over."""
    triangles, corner = mesh.triangles.copy(), mesh.corner.copy()
    triangles[which], corner[which] = triangles[which][:, ::-1], corner[which][:, ::-1]
    return replace(mesh, triangles=triangles, corner=corner)


def _stitched(index: Indices, corners: FloatArray, told: list[str]) -> tuple[Indices, NDArray[np.bool_]]:
    """Return the corner numbers with near corners of open edges joined, and which triangles this moves."""
    edge, low_first = _edge_keys(index)
    is_open = np.bincount(edge, weights=np.where(low_first, 1.0, -1.0))[edge] != 0.0
    rim = np.unique(directed_edges(index)[is_open])
    reach = _GAP * float(np.ptp(corners, axis=0).max())
    pairs = cKDTree(corners[rim]).query_pairs(reach, output_type="ndarray") if len(rim) else np.zeros((0, 2))
    if not len(pairs):
        return index, np.zeros(len(index), bool)
    joined = np.arange(len(corners))
    component = components(pairs.astype(np.int64), size=len(rim))
    joined[rim] = rim[np.unique(component, return_index=True)[1]][component]
    _note(told, np.count_nonzero(joined != np.arange(len(corners))), "corners at gaps were joined to others")
    return joined[index], (joined[index] != index).any(axis=1)


def _note(told: list[str], count: int | np.integer, what: str) -> None:
    if count:
        told.append(f"{count} {what}")


def _corners_of(
    index: Indices, origin: Indices, split: NDArray[np.bool_], *, corners: FloatArray, exact: FloatArray
) -> FloatArray:
    """Return the corners of triangles: those of the file, bit for bit, unless the triangle was split."""
    triangles = corners[index]
    whole = np.flatnonzero(~split)
    of_file = exact[origin[whole]]
    # a triangle that was turned over has its corners in another order
    far = np.abs(of_file - triangles[whole]).max(axis=(1, 2)) > np.abs(
        of_file[:, ::-1] - triangles[whole]
    ).max(axis=(1, 2))
    of_file[far] = of_file[far][:, ::-1]
    triangles[whole] = of_file
    return triangles


def _surfaces(index: Indices) -> Indices:
    """Return the number of the separate surface of each triangle, from 0, shape (T,)."""
    number = components(directed_edges(index), size=int(index.max()) + 1)[index[:, 0]]
    return np.unique(number, return_inverse=True)[1].reshape(-1)


def _edge_keys(index: Indices) -> tuple[Indices, NDArray[np.bool_]]:
    """Return the number of each directed edge's undirected edge, and whether it runs from low to high."""
    edges = directed_edges(index)
    low_first = edges[:, 0] < edges[:, 1]
    key = edges.min(axis=1) * (int(index.max()) + 1) + edges.max(axis=1)
    return np.unique(key, return_inverse=True)[1].reshape(-1), low_first


def _open_edges(index: Indices, surface: Indices) -> Indices:
    """Return the number of directed edges without an opposite one, of each surface."""
    edge, low_first = _edge_keys(index)
    balance = np.abs(np.bincount(edge, weights=np.where(low_first, 1.0, -1.0)))
    of_edge = np.empty(len(balance), np.int64)
    of_edge[edge] = np.repeat(surface, 3)
    return np.bincount(of_edge, weights=balance, minlength=int(surface.max()) + 1).astype(np.int64)


def _without_doubles(
    index: Indices, origin: Indices, corners: FloatArray, told: list[str]
) -> tuple[Indices, Indices]:
    """Return triangles once each; opposite ones as a pair where the surface is closed and has an inside."""
    spot = np.argsort(index, axis=1, kind="stable")
    same = np.take_along_axis(index, spot, axis=1)
    even = np.isin(spot[:, 0] * 9 + spot[:, 1] * 3 + spot[:, 2], _EVEN)
    _, inverse = np.unique(same, axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    number = 2 * inverse + even
    kept = np.zeros(len(index), bool)
    kept[np.unique(number, return_index=True)[1]] = True
    paired = (np.bincount(inverse[kept]) > 1)[inverse] & kept
    if paired.any():
        surface = _surfaces(index)
        open_edges = _open_edges(index[kept], surface[kept])
        hollow = np.abs(_volumes(corners[index[kept]], surface[kept], len(open_edges))) < _NO_VOLUME
        once = paired & ((open_edges > 0) | hollow)[surface]
        first = np.zeros(len(index), bool)
        first[np.unique(inverse, return_index=True)[1]] = True
        kept &= ~once | first
    _note(told, np.count_nonzero(~kept), "triangles that occur several times were kept once")
    return index[kept], origin[kept]


_EVEN = np.array([0 * 9 + 1 * 3 + 2, 1 * 9 + 2 * 3 + 0, 2 * 9 + 0 * 3 + 1])
"""Codes of the even permutations of three corners."""


def _volumes(triangles: FloatArray, surface: Indices, count: int) -> FloatArray:
    """Return the signed volume of each surface, over the cube of its extent."""
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, surface, triangles.min(axis=1))
    np.maximum.at(high, surface, triangles.max(axis=1))
    a, b, c = np.moveaxis(triangles - 0.5 * (low + high)[surface][:, None], 1, 0)
    signed = np.bincount(surface, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0, minlength=count)
    extent = np.maximum((high - low).max(axis=1), np.finfo(float).tiny)
    return np.asarray(signed / extent**3)


def _without_slivers(
    index: Indices, origin: Indices, corners: FloatArray, told: list[str]
) -> tuple[Indices, Indices, NDArray[np.bool_]]:
    """Return triangles without those whose corners lie on a line: the neighbour at the longest side is split.

    The neighbour may be such a triangle too; each split replaces a longest side by a shorter one.
    """
    thin_m = _THIN * float(np.ptp(corners, axis=0).max())
    split = np.zeros(len(index), bool)
    _note(told, len(_slivers(corners[index], thin_m)[0]), "triangles without area were taken out")
    for _ in range(_ROUNDS):
        sliver, top = _slivers(corners[index], thin_m)
        if not len(sliver):
            break
        a, b, c = (index[sliver, (top + step) % 3] for step in (1, 0, 2))
        neighbour, place = _beside(index, start=c, end=a, apart_from=sliver)
        chosen = _apart(sliver, neighbour)
        lone = neighbour < 0  # at a boundary: without it, the boundary runs over its middle corner
        n, a, b, c = neighbour[chosen], a[chosen], b[chosen], c[chosen]
        d = index[n, (place[chosen] + 2) % 3]
        halves = np.concatenate([np.stack([c, b, d], axis=1), np.stack([b, a, d], axis=1)])
        gone = np.zeros(len(index), bool)
        gone[n] = gone[sliver[chosen]] = gone[sliver[lone]] = True
        index = np.concatenate([index[~gone], halves])
        origin = np.concatenate([origin[~gone], origin[n], origin[n]])
        split = np.concatenate([split[~gone], np.ones(len(halves), bool)])
        real = (index != np.roll(index, -1, axis=1)).all(axis=1)
        index, origin, split = index[real], origin[real], split[real]
    left, _ = _slivers(corners[index], 0.0)
    kept = np.ones(len(index), bool)
    kept[left] = False
    return index[kept], origin[kept], split[kept]


def _apart(sliver: Indices, neighbour: Indices) -> NDArray[np.bool_]:
    """Return which slivers can be removed in one round: no triangle is in two of the pairs."""
    used: set[int] = set()
    chosen = np.zeros(len(sliver), bool)
    for number, pair in enumerate(zip(sliver.tolist(), neighbour.tolist(), strict=True)):
        if pair[1] >= 0 and used.isdisjoint(pair):
            used.update(pair)
            chosen[number] = True
    return chosen


def _slivers(triangles: FloatArray, thin_m: float) -> tuple[Indices, Indices]:
    """Return the triangles lower than a limit, and the corner opposite to their longest side."""
    sides = np.linalg.norm(np.roll(triangles, -2, axis=1) - np.roll(triangles, -1, axis=1), axis=2)
    doubled_area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    found = np.flatnonzero(doubled_area <= thin_m * sides.max(axis=1))
    return found, np.argmax(sides[found], axis=1)


def _beside(index: Indices, *, start: Indices, end: Indices, apart_from: Indices) -> tuple[Indices, Indices]:
    """Return a triangle, other than the given ones, at each directed edge, and the edge's place in it.

    One that runs along the edge is preferred to one that runs back; without any, the triangle is -1.
    """
    nodes = int(index.max()) + 1
    edges = directed_edges(index)
    key = np.concatenate([edges @ (nodes, 1), edges @ (1, nodes)])
    order = np.argsort(key, kind="stable")
    wanted = start * nodes + end
    low, high = (np.searchsorted(key[order], wanted, side=side) for side in ("left", "right"))
    found = np.full(len(wanted), -1)
    for step in range(int((high - low).max(initial=0))):
        edge = order[np.minimum(low + step, len(order) - 1)] % len(edges)
        usable = (found < 0) & (low + step < high) & (edge // 3 != apart_from)
        found = np.where(usable, edge, found)
    return np.where(found < 0, -1, found // 3), np.maximum(found, 0) % 3


def _turned_alike(index: Indices, told: list[str]) -> tuple[Indices, Indices]:
    """Return triangles that face the same side within each patch, and the patches' numbers.

    Each triangle is two nodes, as it is and turned over; an edge of two triangles joins the nodes that agree.
    A component of this graph is one way to turn a patch. A patch of a surface with one side only (a Möbius
    strip) stays as it is.
    """
    count = len(index)
    edge, low_first = _edge_keys(index)
    order = np.argsort(edge, kind="stable")
    begins = np.flatnonzero(np.diff(edge[order], prepend=-1))
    two = np.diff(np.append(begins, len(order))) == 2
    one, other = order[begins[two]], order[begins[two] + 1]
    agrees = low_first[one] != low_first[other]
    first, second = one // 3, other // 3
    pairs = np.concatenate(
        [
            np.stack([first, np.where(agrees, second, second + count)], axis=1),
            np.stack([first + count, np.where(agrees, second + count, second)], axis=1),
        ]
    )
    node = components(pairs, size=2 * count)
    patch = np.unique(np.minimum(node[:count], node[count:]), return_inverse=True)[1].reshape(-1)
    two_sided = node[:count] != node[count:]
    as_is = node[:count] < node[count:]
    votes = np.bincount(patch, weights=np.where(as_is, 1.0, -1.0))
    turn = two_sided & (as_is != (votes[patch] >= 0.0))
    _note(told, np.count_nonzero(turn), "triangles were turned over to face like their neighbours")
    result = index.copy()
    result[turn] = result[turn][:, ::-1]
    return result, patch


def _turned_outwards(mesh: RepairedMesh, told: list[str]) -> RepairedMesh:
    """Return the mesh with its closed surfaces facing outwards, and the list of what was repaired."""
    count = len(mesh.open_edges)
    volumes = _volumes(mesh.triangles, mesh.surface, count)
    closed = mesh.open_edges == 0
    no_inside = closed & (np.abs(volumes) < _NO_VOLUME)
    inwards = closed & ~no_inside & (volumes < 0.0)
    cavity = _enclosed(mesh, inwards, closed & ~no_inside & ~inwards)
    inwards &= ~cavity
    _note(told, np.count_nonzero(inwards), "closed surfaces that faced inwards were turned outwards")
    _note(told, np.count_nonzero(cavity), "enclosed cavities are filled: no sensor sees them")
    _note(told, np.count_nonzero(no_inside), "closed surfaces enclose no volume: they are sheets")
    if not closed.all():
        told.append(
            f"{np.count_nonzero(~closed)} of {count} separate surfaces are open, with "
            f"{mesh.open_edges.sum()} open edges: inside is where hardly any direction sees a place (a box "
            "with a hole is solid, a cup is hollow)"
        )
    result = turned(mesh, inwards[mesh.surface]) if inwards.any() else mesh
    return replace(result, no_inside=no_inside, cavity=cavity, told=tuple(told))


def _enclosed(mesh: RepairedMesh, inner: NDArray[np.bool_], outer: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of the inner surfaces lie inside of the outer ones, by the outer ones' winding number."""
    found = np.zeros(len(inner), bool)
    if inner.any() and outer.any():
        first = np.unique(mesh.surface, return_index=True)[1][inner]
        shell = mesh.triangles[outer[mesh.surface]]
        found[inner] = winding_number(shell, mesh.triangles[first].mean(axis=1)) > 0.5
    return found


def winding_number(triangles: FloatArray, points: NDArray[np.floating]) -> FloatArray:
    """Return the generalised winding number of triangles, which need not be closed, about points, (N, 3).

    Source: G. Barill et al., Fast winding numbers for soups and clouds, ACM Trans. Graph. 37 (2018); libigl.
    """
    import igl  # noqa: PLC0415 - only a build with a mesh needs it

    faces = np.arange(3 * len(triangles), dtype=np.int64).reshape(-1, 3)
    corners = np.ascontiguousarray(triangles.reshape(-1, 3), np.float64)
    return np.asarray(igl.fast_winding_number(corners, faces, np.ascontiguousarray(points, np.float64)))
