"""Random satellites: their seeds, their ranges, their symmetries, and that each becomes a target."""

import numpy as np
import pytest
import yaml

from rpod_schemas.config.base import check
from rpod_target import TargetError, load_target
from rpod_target.loading import _read
from rpod_target.parameters import TargetParameters
from rpod_target.population import MATERIALS, POPULATIONS, name_of, random_satellite, satellite_of
from rpod_target.population.satellite import SIZES_M, SMALL_SIZES_M, TRIANGLES
from rpod_target.symmetry import find_symmetries
from rpod_target.visibility import as_tensor, scene_of

NUMBERS = range(24)
COARSE = {True: (23, 32), False: (2, 4)}
"""Satellites of few triangles, by whether they have an exact symmetry; to draw until some come takes 15 s."""
COARSEST = 6_000
"""Number of triangles up to which a test builds a satellite."""


@pytest.fixture(scope="module")
def drawn():
    return [random_satellite("report", seed=1, index=index) for index in NUMBERS]


@pytest.fixture(scope="module")
def coarse():
    """Some satellites of few triangles that have an exact symmetry, and some that have none."""
    found = {
        exact: [random_satellite("derive", seed=1, index=index) for index in numbers]
        for exact, numbers in COARSE.items()
    }
    for exact, satellites in found.items():
        for each in satellites:
            assert ("exact: true" in each.parameters) is exact, "where the draws changed, choose others"
            assert each.triangles < COARSEST
    return found


def test_the_same_seed_gives_the_same_bytes():
    first = random_satellite("report", seed=3, index=5)
    random_satellite.cache_clear()
    again = random_satellite("report", seed=3, index=5)
    assert again is not first
    assert again == first


def test_the_populations_share_no_satellite():
    of_all = [random_satellite(name, seed=3, index=0) for name in POPULATIONS]
    assert len({next(iter(each.meshes.values())) for each in of_all}) == len(POPULATIONS)
    assert len({(each.size_m, each.triangles) for each in of_all}) == len(POPULATIONS)


def test_sizes_and_numbers_of_triangles_are_within_their_ranges_and_spread_over_them(drawn):
    sizes_m = np.array([each.size_m for each in drawn])
    triangles = np.array([each.triangles for each in drawn])
    assert sizes_m.min() >= SIZES_M[0]
    assert sizes_m.max() <= SIZES_M[1]
    assert sizes_m.max() / sizes_m.min() > 30.0
    assert triangles.min() >= TRIANGLES[0]
    assert triangles.max() <= TRIANGLES[1]
    assert triangles.max() / triangles.min() > 30.0


def test_there_is_every_kind_of_body_and_of_equipment(drawn):
    assert {each.body for each in drawn} == {"box", "hexagon", "octagon", "cylinder", "truss"}
    parts = {part["name"] for each in drawn for part in yaml.safe_load(each.parameters)["parts"]}
    for name in ("array-cells-1", "array-cells-2", "dish-1", "boom-1", "nozzle", "adapter-ring", "screws"):
        assert name in parts


def test_most_have_no_exact_symmetry_and_some_have(drawn):
    exact = sum("exact: true" in each.parameters for each in drawn)
    assert 0 < exact < 0.25 * len(drawn)


def test_the_reflectances_differ_and_the_classes_of_brightness_do_not(drawn):
    seen = {}
    for each in drawn:
        for name, material in yaml.safe_load(each.parameters)["materials"].items():
            assert material["albedo"] == MATERIALS[name].albedo
            seen.setdefault(name, set()).add(material["reflectivity"])
    assert {name for name, values in seen.items() if len(values) > 1} >= {"solar-cells", "gold-mli", "steel"}


@pytest.mark.parametrize("exact", [True, False])
def test_every_satellite_is_a_target_with_a_distance_field_and_its_own_size(coarse, exact, cache):
    for satellite in coarse[exact]:
        target = load_target(satellite.name, cache=cache)
        field = target.require_field()
        assert np.isfinite(field.values).all()
        assert field.values.min() < 0.0 < field.values.max()
        assert np.ptp(target.triangles_m, axis=(0, 1)).max() == pytest.approx(satellite.size_m, rel=1e-5)
        assert len(target.triangles_m) >= 0.9 * satellite.triangles
        assert len(target.model_points_m) > 1000
        assert len(target.edges_m) > 0
        assert not target.repairs, target.repairs


def test_declared_symmetries_are_those_that_the_surface_has(coarse, cache):
    for satellite in coarse[True]:
        target = load_target(satellite.name, cache=cache)
        (symmetry,) = target.symmetries
        assert symmetry.exact
        for turn in target.turns():
            for material in np.unique(target.triangle_material):
                triangles_m = target.triangles_m[target.triangle_material == material]
                corners_m = turn.apply(triangles_m.reshape(-1, 3))
                off_m = scene_of(triangles_m).compute_distance(as_tensor(corners_m)).numpy()
                assert off_m.max() < 1e-5 * satellite.size_m


def test_where_none_is_declared_the_surface_has_no_exact_symmetry(coarse, cache):
    for satellite in coarse[False]:
        target = load_target(satellite.name, cache=cache)
        assert not target.turns(exact=True)
        assert not any(each.exact for each in find_symmetries(target))


def test_its_files_in_a_folder_are_the_same_target(coarse, cache, tmp_path):
    satellite = coarse[False][0]
    named, written = (
        load_target(satellite.name, cache=cache),
        load_target(satellite.write(tmp_path), cache=cache),
    )
    assert written.digest == named.digest


def test_a_name_is_that_of_one_satellite_and_other_texts_are_none():
    name = name_of("derive", 7, 3)
    assert satellite_of(name).name == name
    assert satellite_of("random-other-7-3") is None
    assert satellite_of(name + "-0") is None
    with pytest.raises(TargetError, match="is unknown"):
        load_target("random-other-7-3")


def test_a_small_one_is_the_same_satellite_at_another_size():
    small, large = (random_satellite("derive", seed=7, index=3, small=small) for small in (True, False))
    assert satellite_of(small.name) == small
    assert SMALL_SIZES_M[0] <= small.size_m <= SMALL_SIZES_M[1]
    assert (small.body, small.triangles) == (large.body, large.triangles)
    assert small.size_m != large.size_m


def test_every_parameter_file_is_valid(drawn):
    for each in drawn:
        parameters = check(TargetParameters, yaml.safe_load(each.parameters), source=each.name)
        assert parameters.name == each.name
        assert set(each.meshes) == {part.file for part in parameters.parts}
    path, parameters, meshes = _read(drawn[-1].name)
    assert (str(path), parameters.name, meshes.keys()) == (each.name, each.name, dict(each.meshes).keys())
