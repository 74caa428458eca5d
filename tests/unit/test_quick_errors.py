"""Errors of arguments are told before the slow imports of what would use them."""

import errno
import signal
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from rpod.__main__ import app
from rpod.errors import failed
from rpod_schemas.errors import ConfigurationError

SCRIPT = """
import sys
from typer.testing import CliRunner
from rpod.target.verbs import target_verbs
done = CliRunner().invoke(target_verbs, sys.argv[1:])
slow = [name for name in ("numba", "scipy", "trimesh") if name in sys.modules]
print(done.exit_code, slow, done.output)
"""


@pytest.mark.parametrize("verb", ["new", "check", "errors"])
def test_a_file_that_is_not_there_is_told_before_anything_slow_is_imported(verb, tmp_path):
    file = tmp_path / "missing.stl"
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, verb, str(file)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.startswith("2 [] ")
    assert f"rpod target {verb}: {file}: cannot be read (No such file or directory)" in done.stdout


@pytest.mark.parametrize(
    ("verb", "fields"),
    [
        ("estimator", "`sensors` and `target` (example: docs/tutorials/your-camera.md)"),
        ("motion", "`target`, `motion` and `duration_s` (example: config/motion.json"),
        ("proxy", "`links` (example: services/rpod_proxy/README.md)"),
    ],
)
def test_a_service_without_a_file_names_the_fields_that_it_needs(verb, fields):
    done = CliRunner().invoke(app, [verb])
    assert done.exit_code == 2
    assert done.stderr.startswith(f"rpod {verb}: no configuration: give --config FILE with {fields}")


def test_an_error_names_its_verb_once(capsys):
    error = ConfigurationError("rpod driver check", "kind", "is unknown")
    assert failed("driver check", error) == 2
    assert capsys.readouterr().err == "rpod driver check: kind: is unknown\n"
    done = CliRunner().invoke(app, ["router", "--listen", "7447"])
    assert done.stderr.startswith("rpod router: listen: is '7447'")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (
            OSError(errno.EROFS, "Read-only file system", "runs"),
            "runs: read-only file system; make the folder writable, or give another path",
        ),
        (
            OSError(errno.ENOSPC, "No space left on device", "runs/a"),
            "runs/a: no space left on device; free space on the disk, or give another path",
        ),
        (OSError(errno.EISDIR, "Is a directory"), "is a directory; it is a folder: give the path of a file"),
        (OSError(errno.EIO, "Input/output error"), "input/output error"),
        (OSError("the device is busy"), "the device is busy"),
    ],
)
def test_an_error_of_the_system_is_told_with_path_and_remedy_and_without_its_number(error, line, capsys):
    assert failed("report", error) == 1
    assert capsys.readouterr().err == f"rpod report: {line}\n"


def test_a_folder_in_which_a_run_cannot_write_is_told_by_its_option(tmp_path):
    (tmp_path / "notes.txt").touch()
    done = CliRunner().invoke(app, ["run", "mockup-oblique", "--out", str(tmp_path / "notes.txt")])
    assert done.exit_code == 1
    assert done.stderr.startswith(f"rpod run: --out: {tmp_path}/notes.txt/mockup-oblique-")
    assert done.stderr.endswith("move it away, or give another path\n")


def test_a_process_that_compiled_code_ends_tells_the_call():
    script = """
import os, signal, sys
import rpod.__main__
rpod.__main__.app = lambda: os.kill(os.getpid(), signal.SIGSEGV)
rpod.__main__.main()
"""
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert ended.returncode == -signal.SIGSEGV
    assert "Segmentation fault" in ended.stderr
    assert "in main" in ended.stderr
