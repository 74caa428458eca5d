"""The picture of the architecture is that of today's imports."""

import itertools
import re
from html import unescape

import grimp

from rpod_site import architecture

POSE = "rpod_pose"


def test_the_picture_shows_todays_imports():
    """Draw it anew by ``PYTHONPATH=deploy/site python -m rpod_site.architecture``."""
    graph = architecture.import_graph()
    today = architecture.described(
        architecture.edges_of_packages(graph), architecture.packages_of_pose(graph)
    )
    shown = re.search(r"<desc>(.*?)</desc>", architecture.PICTURE.read_text("utf-8"), re.DOTALL)
    assert shown is not None
    assert unescape(shown[1]) == today


def test_an_import_that_follows_from_others_is_no_arrow():
    edges = {"a": frozenset("bc"), "b": frozenset("c"), "c": frozenset()}
    assert architecture.reduced(edges) == {"a": frozenset("b"), "b": frozenset("c"), "c": frozenset()}
    assert architecture.layers(edges) == [["a"], ["b"], ["c"]]


def test_lidar_and_pmd_do_not_import_each_other():
    edges = architecture.packages_of_pose(architecture.import_graph())
    assert "rpod_pose.pmd" not in edges["rpod_pose.lidar"]
    assert "rpod_pose.lidar" not in edges["rpod_pose.pmd"]


def test_a_file_lives_with_the_narrowest_thing_that_needs_it():
    assert [
        f"{module}: only {home} needs it" for module, home in misplaced(architecture.import_graph())
    ] == []


def test_a_file_that_one_package_alone_needs_is_found():
    graph = grimp.ImportGraph()
    for name in (
        "rpod_pose",
        "rpod_pose.search",
        "rpod_pose.search.one",
        "rpod_pose.pmd",
        "rpod_pose.pmd.fit",
    ):
        graph.add_module(name)
    graph.add_import(importer="rpod_pose.pmd.fit", imported="rpod_pose.search.one")
    assert misplaced(graph) == [("rpod_pose.search.one", "rpod_pose.pmd")]
    graph.add_module("rpod_pose.methods")
    graph.add_import(importer="rpod_pose.methods", imported="rpod_pose.search.one")
    assert misplaced(graph) == []


def misplaced(graph: grimp.ImportGraph) -> list[tuple[str, str]]:
    """Return the modules of ``rpod_pose`` that only one other of its packages needs, with this package.

    A module may be in a package below the one that needs it: the packages divide the work of that one.
    """
    found = []
    for module in sorted(graph.find_descendants(POSE)):
        users = graph.find_modules_that_directly_import(module)
        if users and not graph.find_children(module):
            home = _shared([user if graph.find_children(user) else _parent(user) for user in users])
            if home.startswith(POSE) and not f"{_parent(module)}.".startswith(f"{home}."):
                found.append((module, home))
    return found


def _parent(module: str) -> str:
    return module.rpartition(".")[0]


def _shared(packages: list[str]) -> str:
    """Return the narrowest package that holds all packages."""
    parts = [package.split(".") for package in packages]
    same = itertools.takewhile(lambda names: len(set(names)) == 1, zip(*parts, strict=False))
    return ".".join(names[0] for names in same)
