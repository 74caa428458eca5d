"""Size of the arrays that a glTF document announces, which its reader makes before it looks at them.

A few bytes can announce any number of values: by an array without a buffer, by many arrays over the same
bytes, and by many surfaces of the same corners. So the document is examined before it is read.
"""

from collections.abc import Iterator
from typing import Any

from rpod_target.mesh.gltf_arrays import bytes_of

_CORNERS_OF_TRIANGLE = 3
_WRONG = "announces an array of {} values: export it again"


def too_many(document: Any, *, most_bytes: int, most_triangles: int) -> str:
    """Return why a glTF document announces more than is read and what to do, or an empty text.

    What is no glTF gives an empty text as well: its reader refuses it.

    Args:
        document: the document, parsed.
        most_bytes: largest number of bytes of all arrays.
        most_triangles: largest number of triangles; three corners of each are the most corners.
    """
    accessors = [each for each in _list(document, "accessors") if isinstance(each, dict)]
    for count in _counts(accessors):
        if not isinstance(count, int) or count < 0:
            return _WRONG.format(repr(count))
    if (size := sum(map(_bytes, accessors))) > most_bytes:
        return f"announces {size} bytes in its arrays, at most {most_bytes} are read: simplify it"
    corners = triangles = 0
    for primitive in _primitives(document):
        places = _count(primitive.get("attributes"), "POSITION", accessors)
        used = _count(primitive, "indices", accessors) if "indices" in primitive else places
        corners += places
        triangles += used // _CORNERS_OF_TRIANGLE if primitive.get("mode", 4) == 4 else used
    if triangles > most_triangles:
        return f"announces {triangles} triangles, at most {most_triangles} are read: simplify it first"
    if corners > _CORNERS_OF_TRIANGLE * most_triangles:
        most = _CORNERS_OF_TRIANGLE * most_triangles
        return f"announces {corners} corners in its surfaces, at most {most} are read: simplify it first"
    return ""


def _counts(accessors: list[dict[str, Any]]) -> Iterator[Any]:
    for each in accessors:
        yield each.get("count", 0)
        if isinstance(sparse := each.get("sparse"), dict):
            yield sparse.get("count", 0)


def _bytes(accessor: dict[str, Any]) -> int:
    return int(accessor.get("count", 0)) * bytes_of(accessor)


def _primitives(document: Any) -> Iterator[dict[str, Any]]:
    for mesh in _list(document, "meshes"):
        yield from (each for each in _list(mesh, "primitives") if isinstance(each, dict))


def _count(owner: Any, name: str, accessors: list[dict[str, Any]]) -> int:
    """Return the number of values of the accessor that a name refers to; 0 if it is none."""
    number = owner.get(name) if isinstance(owner, dict) else None
    if not isinstance(number, int) or not 0 <= number < len(accessors):
        return 0
    return int(accessors[number].get("count", 0))


def _list(owner: Any, name: str) -> list[Any]:
    found = owner.get(name) if isinstance(owner, dict) else None
    return found if isinstance(found, list) else []
