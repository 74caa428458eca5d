"""``rpod compile``: the numerical kernels are compiled before the first run, not during it."""

import os
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from rpod_analysis.target_check.trials import try_methods
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.sensors import sensor_kind, sensor_kinds
from rpod_target import load_target

_TARGET = "mockup"
_FRAMES = 3
"""Frames on which each method is tried: the first pose, and what follows only from a pose."""


def compile_command() -> int:
    """Compile the kernels of emulators and methods, each kind of sensor in a process; return the exit code.

    Numba keeps what is compiled: in ``NUMBA_CACHE_DIR``, beside the sources, or in the user's cache.
    """
    names = [kind.name for kind in sensor_kinds()]
    workers = min(len(names), os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for name, took_s in zip(names, pool.map(_compile, names), strict=True):
            print(f"compiled: {name}, {took_s:.0f} s")
    return EXIT_OK


def _compile(name: str) -> float:
    """Emulate frames of a kind of sensor and run all of its methods on them; return the time, s."""
    begin_s = time.monotonic()
    try_methods(load_target(_TARGET), trials=_FRAMES, kinds=[sensor_kind(name)])
    return time.monotonic() - begin_s
