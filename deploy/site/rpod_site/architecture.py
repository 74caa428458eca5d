"""The picture of the architecture, drawn from the imports: packages in layers, and those of ``rpod_pose``.

``python -m rpod_site.architecture`` writes ``docs/images/architecture.svg`` anew. An arrow runs from a
package to one that it imports; an import that follows from others is left out.
"""

import tomllib
from html import escape
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[3]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
Edges = dict[str, frozenset[str]]

_BOX, _GAP, _ROW = (126, 34), 14, 74
_WIDTH = 1000
_POSE = "rpod_pose"
_COLOURS = {
    "rpod": "#e8eaf6",
    "rpod_campaign": "#e8eaf6",
    "rpod_analysis": "#e8eaf6",
    "rpod_pose": "#fff3e0",
    "rpod_sim_sensor": "#e0f2f1",
    "rpod_geometry": "#f1f8e9",
    "rpod_target": "#f1f8e9",
    "rpod_schemas": "#f5f5f5",
    "rpod_runtime": "#f5f5f5",
    "rpod_security": "#f5f5f5",
}


def package_layers() -> list[list[str]]:
    """Return the packages of the project in layers, as the first import contract has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    contract = settings["tool"]["importlinter"]["contracts"][0]
    return [layer.split(" | ") for layer in contract["layers"]]


def imports(graph: grimp.ImportGraph, names: list[str], depth: int = 1) -> Edges:
    """Return which of some packages import which others directly, by the first ``depth`` parts of a name."""
    known = set(names)
    found: dict[str, set[str]] = {name: set() for name in names}
    for name in names:
        for module in (name, *graph.find_descendants(name)):
            for imported in graph.find_modules_directly_imported_by(module):
                found[name].add(".".join(imported.split(".")[:depth]))
    return {name: frozenset(found[name] & known - {name}) for name in names}


def reduced(edges: Edges) -> Edges:
    """Return the edges that do not follow from others."""
    reach: dict[str, frozenset[str]] = {}

    def below(name: str) -> frozenset[str]:
        if name not in reach:
            reach[name] = edges[name].union(*(below(other) for other in edges[name]))
        return reach[name]

    return {
        name: frozenset(
            other for other in others if not any(other in below(via) for via in others if via != other)
        )
        for name, others in edges.items()
    }


def layers(edges: Edges) -> list[list[str]]:
    """Return the packages in rows: each stands above all that it imports, as low as possible."""
    height: dict[str, int] = {}

    def of(name: str) -> int:
        if name not in height:
            height[name] = 1 + max((of(other) for other in edges[name]), default=-1)
        return height[name]

    rows: dict[int, list[str]] = {}
    for name in edges:
        rows.setdefault(of(name), []).append(name)
    return [rows[level] for level in sorted(rows, reverse=True)]


def edges_of_packages(graph: grimp.ImportGraph) -> Edges:
    """Return the packages of the project and their imports."""
    return imports(graph, [name for layer in package_layers() for name in layer])


def packages_of_pose(graph: grimp.ImportGraph) -> Edges:
    """Return the packages within ``rpod_pose``, its folders, and their imports."""
    folders = sorted(child for child in graph.find_children(_POSE) if graph.find_children(child))
    return imports(graph, folders, depth=2)


def import_graph() -> grimp.ImportGraph:
    """Return the imports of all packages of the project."""
    return grimp.build_graph(*(name for layer in package_layers() for name in layer))


def drawn() -> str:
    """Return the picture as SVG."""
    graph = import_graph()
    whole, inside = edges_of_packages(graph), packages_of_pose(graph)
    top, whole_end = _figure(whole, package_layers(), top=40)
    below, end = _figure(inside, layers(inside), top=whole_end + 50)
    title = f'<text x="10" y="{whole_end + 36}" class="title">packages of rpod_pose</text>'
    return "\n".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {end}" role="img">',
            f"<desc>{escape(described(whole, inside))}</desc>",
            "<style>text{font:13px sans-serif;text-anchor:middle}.title{font-weight:bold;text-anchor:start}"
            "path{fill:none;stroke:#78909c;stroke-width:1.2}rect{stroke:#90a4ae}</style>",
            '<defs><marker id="to" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
            'orient="auto"><path d="M0,0 L8,4 L0,8 z" style="fill:#78909c;stroke:none"/></marker></defs>',
            f'<rect width="{_WIDTH}" height="{end}" style="fill:#fff;stroke:none"/>',
            '<text x="10" y="26" class="title">packages; an arrow: imports</text>',
            *top,
            title,
            *below,
            "</svg>\n",
        )
    )


def described(*parts: Edges) -> str:
    """Return the edges in words, by which a test knows an old picture."""
    lines = (
        f"{name} imports {', '.join(sorted(edges[name])) or 'none'}" for edges in parts for name in edges
    )
    return "; ".join(lines)


def _figure(edges: Edges, rows: list[list[str]], *, top: int) -> tuple[list[str], int]:
    """Return the SVG of a graph in rows, from a height on, and where it ends."""
    wide, high = _BOX
    place: dict[str, tuple[float, float]] = {}
    for index, row in enumerate(rows):
        left = (_WIDTH - len(row) * wide - (len(row) - 1) * _GAP) / 2
        for column, name in enumerate(row):
            place[name] = left + column * (wide + _GAP), top + index * _ROW
    arrows = [
        _arrow(place[name], place[other])
        for name, others in reduced(edges).items()
        for other in sorted(others)
    ]
    boxes = [
        f'<rect x="{x:g}" y="{y:g}" width="{wide}" height="{high}" rx="6" '
        f'fill="{_COLOURS.get(name, "#fff8e1" if "." in name else "#e3f2fd")}"/>'
        f'<text x="{x + wide / 2:g}" y="{y + high / 2 + 5:g}">{name.rpartition(".")[2]}</text>'
        for name, (x, y) in place.items()
    ]
    return arrows + boxes, top + len(rows) * _ROW


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    wide, high = _BOX
    x0, y0, x1, y1 = start[0] + wide / 2, start[1] + high, end[0] + wide / 2, end[1] - 2
    bend = (y1 - y0) / 2
    curve = f"M{x0:g},{y0:g} C{x0:g},{y0 + bend:g} {x1:g},{y1 - bend:g} {x1:g},{y1:g}"
    return f'<path d="{curve}" marker-end="url(#to)"/>'


if __name__ == "__main__":
    PICTURE.write_text(drawn(), encoding="utf-8")
