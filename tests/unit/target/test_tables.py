"""Tables that are computed once, and kept in the cache of targets."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc

from rpod_pose.search.even_samples import sobol
from rpod_target import load_target
from rpod_target.tables import kept, kept_of


class _Maker:
    """Counts how often it computes its table."""

    calls = 0

    def __call__(self):
        self.calls += 1
        return {"squares": np.arange(4) ** 2}


@pytest.fixture
def _cache(tmp_path, monkeypatch):
    monkeypatch.setenv("RPOD_CACHE", str(tmp_path))


@pytest.mark.usefixtures("_cache")
def test_a_table_is_computed_once_for_each_input_and_version():
    make = _Maker()

    cases = (1, 2.0), (1, 2.0), (1, 3.0), (2, 2.0)
    found = [kept("t", version, (number,), make) for version, number in cases]

    assert make.calls == 3
    assert all(list(each) == ["squares"] and each["squares"].tolist() == [0, 1, 4, 9] for each in found)


@pytest.mark.usefixtures("_cache")
def test_a_table_that_is_damaged_is_computed_again(tmp_path):
    make = _Maker()
    kept("t", 1, (), make)
    (file,) = tmp_path.glob("table-t-*.npz")
    file.write_bytes(file.read_bytes()[:100])

    assert kept("t", 1, (), make)["squares"].tolist() == [0, 1, 4, 9]
    assert make.calls == 2


@pytest.mark.usefixtures("_cache")
def test_tables_of_shapes_that_no_file_has_are_not_kept(tmp_path):
    target = replace(load_target("mockup"), content="")

    kept_of(target, "t", 1, (target.triangles_m,), _Maker())

    assert not list(tmp_path.glob("table-*"))


@pytest.mark.usefixtures("_cache")
def test_even_samples_are_those_of_scipy_also_from_the_cache():
    expected = qmc.Sobol(3, seed=1).random_base2(4)

    assert np.array_equal(sobol(3, 4), expected)
    assert np.array_equal(sobol(3, 4), expected)


def test_a_start_of_services_imports_neither_open3d_nor_scipys_statistics_nor_its_solvers():
    program = (
        "import sys, rpod_estimator.daemon, rpod_emulator.daemon, rpod_pose.pmd.methods, "
        "rpod_pose.lidar.methods; "
        "slow = ('open3d', 'scipy.stats', 'scipy.optimize', 'plotly', 'mcap'); "
        "print([name for name in slow if name in sys.modules])"
    )

    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)

    assert done.stdout.strip() == "[]"
