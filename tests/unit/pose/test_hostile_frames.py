"""No frame that the messages allow makes a method raise, or compiled code read beyond an array."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests import hostile_frames

TRIED = 60
"""Cases in a test; ``python tests/hostile_frames.py 1200`` tries more."""


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # NumPy tells of overflows, which are meant here
def test_no_frame_and_no_prediction_raises():
    assert not hostile_frames.failures(range(TRIED))


@pytest.mark.timeout(600)
def test_no_compiled_code_reads_beyond_an_array(tmp_path):
    """Numba checks indices where it is told to as it compiles; what is kept on disk is not checked."""
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_OPT": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    program = [sys.executable, str(Path(hostile_frames.__file__)), str(TRIED)]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
