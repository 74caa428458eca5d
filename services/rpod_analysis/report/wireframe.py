"""A wireframe as SVG paths."""

from rpod_schemas.arrays import FloatArray


def svg_path(segments: FloatArray) -> str:
    """Return the path data of segments, shape (N, 2, 2); successive segments with a common end are joined."""
    parts: list[str] = []
    last = ""
    for start, end in segments:
        begin, finish = f"{start[0]:.1f} {start[1]:.1f}", f"{end[0]:.1f} {end[1]:.1f}"
        parts.append(f"L{finish}" if begin == last else f"M{begin}L{finish}")
        last = finish
    return "".join(parts)
