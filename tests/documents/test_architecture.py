"""The picture of the architecture is that of today's imports."""

import re
from html import unescape

from rpod_site import architecture


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
