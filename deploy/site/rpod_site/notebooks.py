"""Runs the notebooks and writes them as pages; the repository keeps them without outputs."""

import os
import sys
import tempfile
from pathlib import Path

import nbformat
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

_FOLDER = Path("docs") / "notebooks"
_TIMEOUT_S = 120
_QUIET = {"JUPYTER_PLATFORM_DIRS": "1", "PYDEVD_DISABLE_FILE_VALIDATION": "1"}


def stage(root: Path, pages: Path, *, execute: bool) -> None:
    """Write each notebook as a page with its figures beside it; an error in a cell ends the build."""
    for file in sorted((root / _FOLDER).glob("*.ipynb")):
        notebook = nbformat.reads(file.read_text("utf-8"), as_version=4)  # type: ignore[no-untyped-call]
        if execute:
            run(notebook)
        _write(notebook, file, pages / _FOLDER)


def run(notebook: nbformat.NotebookNode) -> None:
    """Run the cells in an empty folder, with the programs of this environment first in the path."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    os.environ.update(_QUIET)
    with tempfile.TemporaryDirectory() as folder:
        kernel = KernelManager(
            transport="ipc", ip=str(Path(folder, "kernel"))
        )  # sockets of this user, no ports
        client = NotebookClient(
            notebook, km=kernel, timeout=_TIMEOUT_S, resources={"metadata": {"path": folder}}
        )
        try:
            client.execute(env=os.environ | {"PATH": path})
        finally:
            kernel.shutdown_kernel(now=True)


def _write(notebook: nbformat.NotebookNode, file: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    resources = {"output_files_dir": f"{file.stem}_files"}
    exporter = MarkdownExporter()  # type: ignore[no-untyped-call]
    text, written = exporter.from_notebook_node(notebook, resources=resources)
    for name, content in written["outputs"].items():
        output = folder / name
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_bytes(content)
    (folder / f"{file.stem}.md").write_text(text, "utf-8")
