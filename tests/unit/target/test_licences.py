"""libigl's packages for Python hold modules under other licences than its core (MPL-2.0): none is imported.

``igl.copyleft`` is under the GPL (CGAL) and the AGPL (TetGen); ``igl.triangle`` (Triangle) may not be used
commercially.
"""

import ast
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path

ROOT = Path(__file__).parents[3]
FOLDERS = ("schemas", "services", "sim_sensor", "benchmarks", "deploy", "docs/examples")
CORE = "igl"


def imported(file: Path) -> Iterator[str]:
    """Yield the dotted names of modules, and of what is taken from modules, that a file imports."""
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from (f"{node.module}.{each.name}" for each in node.names)


def test_no_module_of_libigl_but_its_core_is_imported() -> None:
    found = {
        (file.relative_to(ROOT).as_posix(), name)
        for folder in FOLDERS
        for file in (ROOT / folder).rglob("*.py")
        for name in imported(file)
        if name.split(".")[0] == CORE
    }
    assert found == {("sim_sensor/rpod_target/mesh/repair.py", CORE)}


def test_the_core_loads_nothing_else_of_libigl() -> None:
    code = (
        "import sys, numpy as np; from rpod_target.mesh.repair import winding_number; "
        "winding_number(np.eye(3)[None], np.zeros((1, 3))); "
        "print(*(name for name in sys.modules if name.partition('.')[0] == 'igl'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == {"igl", "igl.pyigl_core"}


def test_the_package_is_laid_out_as_this_test_assumes() -> None:
    names = {str(file) for file in distribution("libigl").files or ()}
    assert "igl/copyleft/__init__.py" in names
    assert "igl/triangle/__init__.py" in names
