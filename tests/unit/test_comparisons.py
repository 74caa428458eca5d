"""No test orders tuples: ``(0.1, 9.0) < (0.2, 0.5)`` is true, since the first elements decide."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted(
    file for room in ("tests", "docs/examples", "benchmarks") for file in (ROOT / room).rglob("*.py")
)
ORDER = ast.Lt | ast.LtE | ast.Gt | ast.GtE
_tree = cache(ast.parse)


def ordered_tuples(source: str, functions: frozenset[str]) -> Iterator[str]:
    """Yield the comparisons that order a tuple, or what a function of these names returns.

    A comparison of an array with a tuple, ``(points < (2, 3)).all()``, is one of each element.
    """
    tree = _tree(source)
    of_arrays = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and node.attr in ("all", "any")
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and id(node) not in of_arrays:
            sides = (node.left, *node.comparators)
            if any(isinstance(operator, ORDER) for operator in node.ops) and any(
                isinstance(side, ast.Tuple)
                or (isinstance(side, ast.Call) and ast.unparse(side.func) in functions)
                for side in sides
            ):
                yield ast.unparse(node)


def returning_tuples(source: str) -> Iterator[str]:
    """Yield the names of a module's functions that return a tuple."""
    for node in ast.walk(_tree(source)):
        if isinstance(node, ast.FunctionDef) and any(
            isinstance(each, ast.Return) and isinstance(each.value, ast.Tuple) for each in ast.walk(node)
        ):
            yield node.name


def test_no_comparison_orders_tuples():
    sources = {file: file.read_text("utf-8") for file in FILES}
    shared = {
        name
        for file, text in sources.items()
        if file.parent == ROOT / "tests"
        for name in returning_tuples(text)
    }
    found = {
        str(file.relative_to(ROOT)): list(ordered_tuples(text, frozenset({*shared, *returning_tuples(text)})))
        for file, text in sources.items()
    }
    assert not {file: comparisons for file, comparisons in found.items() if comparisons}


@pytest.mark.parametrize(
    ("text", "ordered"),
    [
        ("assert errors(T) < (0.2, 0.5)", True),
        ("assert errors(T) < limits", True),
        ("assert errors(T)[0] < 0.2", False),
        ("assert errors(T) == (0.2, 0.5)", False),
        ("assert (points < (2, 3)).all()", False),
    ],
)
def test_a_comparison_of_tuples_is_found(text, ordered):
    functions = frozenset(returning_tuples("def errors(T):\n    return 0.1, 9.0\n"))
    assert list(ordered_tuples(text, functions)) == ([text.removeprefix("assert ")] if ordered else [])
