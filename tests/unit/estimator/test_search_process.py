"""The process of a search as a fork of the estimator: the same result, no lock lost, an end with it.

The forks are made in a process of their own, since the tests' own process has threads of other libraries.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[2]
PREPARED = """
import os, signal, sys
from contextlib import suppress
import numpy as np
from scipy.linalg import cho_factor
from scipy.spatial.transform import RigidTransform
import rpod_estimator.daemon
from rpod_estimator.search_process import Loaded, SearchProcess, found_as_in_process, native_threads
from rpod_runtime.process import lifecycle
threads = native_threads()
from pmd_frames import depth_frame
from rpod_pose.measurement import Measurement
from rpod_pose.methods import ready_methods
from rpod_pose.navigation.first_pose.searches import Search
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_target import load_target
target, sensor = load_target("mockup"), PmdInput()
methods = ready_methods(sensor, target, ())

def search():
    camera = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
    frame = depth_frame(target, make_pose(translation_m=[0.05, 0.0, 4.0]), noise_m=0.01, camera=camera)
    return Search(Measurement("pmd", frame, RigidTransform.identity()), frame)

def result(process):
    for _ in range(600):
        if (found := process.result()) is not None:
            return found
        process._connection.poll(0.1)
    sys.exit("no result")
"""


def said(body: str, *, code: int = 0, **environment: str) -> str:
    """Return what a process with methods and a function ``search`` prints until it ends with this code."""
    paths = os.pathsep.join((str(TESTS), *filter(None, sys.path)))
    supervised, supervisor = os.pipe()
    try:
        ended = subprocess.run(
            [sys.executable, "-c", PREPARED + body],
            env=os.environ | {"PYTHONPATH": paths} | environment,
            stdin=supervised,
            capture_output=True,
            timeout=120,
            text=True,
            check=False,
        )
    finally:
        os.close(supervised)
        os.close(supervisor)
    assert ended.returncode == code, ended.stderr
    return ended.stdout.strip()


def test_a_fork_searches_as_the_estimator_would_and_a_spawned_process_replaces_it():
    body = """
def body(stop):
    matrix = np.eye(600) + 0.1
    matrix @ matrix, cho_factor(matrix)  # OpenBLAS of NumPy and of SciPy have their threads now
    global now_s
    now_s, spawned = 0.0, []
    forked = SearchProcess("mockup", sensor, Loaded(target, methods, ()), now_s=lambda: now_s)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        os.kill(forked._process.pid, number)  # as to a whole group
    asked = search()
    forked.begin(asked, ())
    found, expected = result(forked), found_as_in_process(asked, methods)
    assert expected.acquisition.pose is not None and not stop.is_set()
    one, other = (each.acquisition.pose.as_matrix().tobytes() for each in (found, expected))
    forked._spawn = lambda **how: spawned.append(how)
    forked._process.kill()
    forked._process.join()
    assert "has ended" in forked.result().acquisition.belief.refusal
    now_s = 4.0
    with suppress(OSError):  # nothing was spawned
        forked.result()
    print(one == other, spawned)
lifecycle.run("estimator", body)
"""
    given = said(body, RPOD_SUPERVISED="1", OPENBLAS_NUM_THREADS="2")
    assert given == "True [{'beside_tracking': True}]", "whether poses are equal, to the last bit"


def test_methods_have_no_threads_and_both_forks_end_with_the_estimator():
    body = """
print(threads, native_threads(), flush=True)
forks = [SearchProcess("mockup", sensor, Loaded(target, methods, ())) for _ in range(2)]
for each in forks:
    each.begin(search(), ())
    result(each)
os.kill(os.getpid(), signal.SIGKILL)
"""
    # that this returns shows the end of the forks, which hold the other end of its output
    counted = said(body, code=-signal.SIGKILL, OPENBLAS_NUM_THREADS="1")
    assert counted == "1 1", "threads after the imports, and after the methods"


def test_a_search_has_a_lower_priority_only_while_the_target_is_tracked():
    body = """
from dataclasses import replace
from pathlib import Path
def body(stop):
    forked = SearchProcess("mockup", sensor, Loaded(target, methods, ()))
    tasks = Path(f"/proc/{forked._process.pid}/task")
    for beside_track in (False, True, False):
        forked.begin(replace(search(), beside_track=beside_track), ())
        assert result(forked).acquisition.pose is not None
        threads = {int(each.name): int(each.joinpath("stat").read_text().rpartition(")")[2].split()[16])
                   for each in tasks.iterdir()}
        print(threads.pop(forked._process.pid), sorted(set(threads.values()) - {0}))
lifecycle.run("estimator", body)
"""
    given = said(body, RPOD_SUPERVISED="1", OPENBLAS_NUM_THREADS="1")
    assert given.splitlines() == ["0 []", "0 [10]", "0 [10]"], "of the first thread, and of others"
