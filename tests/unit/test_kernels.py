"""What every compiled function promises: few arguments, named records, types and documentation."""

import importlib
import inspect
import pkgutil
import re
import time
import typing
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numba import njit
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher

import rpod_geometry
import rpod_pose
import rpod_sim_sensor
from rpod_geometry.kernels import inner_kernel, one_at_a_time
from rpod_geometry.kernels import kernel as compiled
from rpod_pose.registration.gauss_newton import minimised

MOST_ARGUMENTS, MOST_RETURNED = 7, 3


def kernels():
    for package in (rpod_geometry, rpod_pose, rpod_sim_sensor):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for name, found in vars(importlib.import_module(module.name)).items():
                if isinstance(found, Dispatcher) and found.py_func.__module__ == module.name:
                    yield pytest.param(found, id=f"{module.name}.{name}")


KERNELS = list(kernels())


def test_kernels_are_found():
    assert len(KERNELS) > 60


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_takes_few_arguments_with_types(kernel):
    parameters = inspect.signature(kernel.py_func).parameters
    assert len(parameters) <= MOST_ARGUMENTS
    for parameter in parameters.values():
        assert parameter.annotation is not parameter.empty, parameter


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_says_what_it_returns_by_name_where_that_is_much(kernel):
    returned = inspect.signature(kernel.py_func).return_annotation
    assert returned is not inspect.Signature.empty
    if typing.get_origin(returned) is tuple:
        assert len(typing.get_args(returned)) <= MOST_RETURNED


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_says_what_it_does(kernel):
    text = inspect.getdoc(kernel.py_func)
    assert text
    assert text.split(maxsplit=1)[0] not in ("Of", "For")


SHAPE = re.compile(
    r"\bshape|\((?:\w+(?: [-+] \d)?,)(?: ?\w+(?: [-+] \d)?,?)*\)|\b[nK] x [nK]\b|arguments|``\w+\.\w+``"
)
"""A shape, such as "shape (N, 3)" or "(3,)", or a reference to a record or function that says it."""


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_that_takes_arrays_says_their_shapes(kernel):
    annotations = typing.get_type_hints(kernel.py_func)
    arrays = [name for name, kind in annotations.items() if typing.get_origin(kind) is np.ndarray]
    assert not set(arrays) - {"return"} or SHAPE.search(inspect.getdoc(kernel.py_func)), arrays


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_is_kept_on_disk_and_releases_the_interpreter(kernel):
    assert kernel.targetoptions["nogil"]
    assert not kernel.targetoptions.get("parallel")
    assert kernel.targetoptions["error_model"] == "numpy"
    assert type(kernel._cache).__name__ != "NullCache" or kernel is minimised


def doubled(x: float) -> float:
    """Return twice a number."""
    return 2.0 * x


def test_an_inner_kernel_serves_kernels_and_refuses_python(monkeypatch, tmp_path):
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    inner = inner_kernel(doubled)
    with pytest.raises(TypeError, match="doubled is an inner kernel"):
        inner(1.0)
    assert compiled(lambda x: inner(x) + inner(x))(1.5) == 6.0
    with pytest.raises(TypeError, match="doubled is an inner kernel"):
        inner(1.0)


def test_a_kernel_is_compiled_once_for_all_numbers_that_its_callers_state(monkeypatch, tmp_path):
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    shared = compiled(doubled)
    assert compiled(lambda n: shared(6) + shared(7) + shared(n))(8) == 42.0
    assert len(shared.signatures) == 1


class Gone(typing.NamedTuple):
    x: float


def length(record: Gone) -> float:
    """Return the only field of a record, m."""
    return abs(record.x)


def test_a_kernel_kept_for_a_record_that_is_no_longer_there_is_compiled_anew(monkeypatch, tmp_path):
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    plain = njit(cache=True)(length)
    assert compiled(length)(Gone(-3.0)) == plain(Gone(-3.0)) == 3.0
    monkeypatch.delitem(globals(), "Gone")
    with pytest.raises(AttributeError, match="Gone"):
        plain._cache._cache_file._load_index()
    assert compiled(length)._cache._cache_file._load_index() == {}


def test_two_processes_that_compile_a_kernel_for_different_types_at_once_keep_both(tmp_path):
    def file():
        made = IndexDataCacheFile(str(tmp_path), "kernel", source_stamp=1)
        load = made._load_index

        def slow():
            found = load()
            time.sleep(0.2)  # the other one reads the index meanwhile
            return found

        made._load_index = slow
        one_at_a_time(made)  # a lock is of an opened file: two threads are like two processes
        return made

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda kind: file().save(kind, f"code for {kind}"), ("float32", "float64")))
    assert {kind: file().load(kind) for kind in ("float32", "float64")} == {
        "float32": "code for float32",
        "float64": "code for float64",
    }
