"""``rpod compile``: the numerical kernels are compiled before the first run, not during it."""

import os
import time
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from multiprocessing import get_context

from rpod_analysis.target_check.emulated import EmulatedKind
from rpod_analysis.target_check.trials import try_methods
from rpod_pose.methods import ready_methods
from rpod_runtime.process.collector import process_starts
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.sensors import sensor_kind, sensor_kinds
from rpod_target import load_target

_TARGET = "mockup"
_SAY_S = 30.0
"""Interval at which the user is told what still compiles, s."""
_FRAMES = 12
"""Number of frames on which each default method runs, so that the code for a first pose and the code that
needs a pose both run. Other methods get a third of them, and ``epnp`` uses only frames that show the nose."""


def compile_command() -> int:
    """Compile the kernels of emulators and methods, each kind of sensor in a process; return the exit code.

    Numba keeps what is compiled: in ``NUMBA_CACHE_DIR``, beside the sources, or in the user's cache.
    """
    names = [kind.name for kind in sensor_kinds()]
    workers, begin_s = min(len(names), os.cpu_count() or 1), time.monotonic()
    print(f"compiling: {', '.join(names)} (minutes the first time)", flush=True)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(_compile, name): name for name in names}
        while waiting:
            done, _ = wait(waiting, timeout=_SAY_S, return_when=FIRST_COMPLETED)
            for future in done:
                print(f"compiled: {waiting.pop(future)}, {future.result():.0f} s", flush=True)
            if not done:
                left, past_s = ", ".join(waiting.values()), time.monotonic() - begin_s
                print(f"compiling: {left}, for {past_s:.0f} s so far", flush=True)
    return EXIT_OK


def _compile(name: str) -> float:
    """Emulate frames of a kind of sensor and run all of its methods on them; return the time, s.

    An estimator warms its methods up with frames like those from the bus, whose arrays are read-only.
    Kernels are compiled separately for these, so this is done here as well.
    """
    process_starts()  # what a compiler makes stays: the collector would examine it again and again
    begin_s, kind, target = time.monotonic(), sensor_kind(name), load_target(_TARGET)
    try_methods(target, trials=_FRAMES, kinds=[kind])
    emulated = EmulatedKind(kind, target, seed=1)
    ready_methods(emulated.heard, target, emulated.setup)
    return time.monotonic() - begin_s
