"""Finding, caching and refusing parameter files."""

import concurrent.futures
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import rpod_target
from rpod_target import Target, TargetError, load_equivalence, load_target, shipped_targets
from rpod_target import cache as store

Build = Callable[..., Target]
Write = Callable[[dict[str, Any]], Path]
MISSING = object()


def assert_same(first: Target, second: Target) -> None:
    assert first.digest == second.digest
    for name in ("triangles_m", "normals", "triangle_material", "edges_m", "model_points_m"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    np.testing.assert_array_equal(first.require_field().values, second.require_field().values)


def test_the_digest_ignores_how_the_file_is_written(
    document: dict[str, Any], write: Write, cache: Path
) -> None:
    file = write(document)
    first = load_target(file, cache=cache)
    file.write_text("# a remark\n" + yaml.safe_dump(document, default_flow_style=True, sort_keys=False))
    assert load_target(file, cache=cache).digest == first.digest


def test_the_digest_follows_every_parameter(build: Build) -> None:
    digests = {
        build().digest,
        build(model_points=201).digest,
        build(edge_crease_deg=31.0).digest,
        build(centre_of_mass_m=[0.0, 0.0, 0.1]).digest,
        build({"shape": "box", "size_m": [2.0, 1.0, 0.5001]}).digest,
    }
    assert len(digests) == 5


def test_a_cached_target_has_its_materials_whatever_their_order(
    document: dict[str, Any], build: Build
) -> None:
    build()
    backwards = build(materials=dict(reversed(document["materials"].items())))
    assert {backwards.materials[index].name for index in backwards.triangle_material} == {"paint"}


def test_the_digest_follows_the_bytes_of_a_mesh(build: Build, write_stl: Callable[[str, Any], Path]) -> None:
    triangles_m = build().triangles_m
    part = {"shape": "mesh", "file": "hull.stl", "metres_per_unit": 1.0}
    write_stl("hull.stl", triangles_m)
    first = build(part)
    write_stl("hull.stl", triangles_m * 1.001)
    assert build(part).digest != first.digest


def test_a_target_from_the_cache_equals_the_one_built(
    document: dict[str, Any], write: Write, tmp_path: Path
) -> None:
    file = write(document)
    built = load_target(file, cache=tmp_path / "one")
    assert_same(load_target(file, cache=tmp_path / "one"), built)
    assert_same(load_target(file, cache=tmp_path / "another"), built)
    assert [path.suffix for path in (tmp_path / "one").iterdir()] == [".npz"]


def test_a_warm_start_does_not_import_open3d(document: dict[str, Any], write: Write, cache: Path) -> None:
    file = write(document)
    load_target(file, cache=cache)
    program = (
        "import sys; from pathlib import Path; from rpod_target import load_target\n"
        "load_target(sys.argv[1], cache=Path(sys.argv[2]))\n"
        "sys.exit('open3d' in sys.modules)"
    )
    paths = [
        str(Path(rpod_target.__file__).parents[1]),
        str(Path(rpod_target.__file__).parents[2] / "schemas"),
    ]
    subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {paths!r}\n" + program, file, cache], check=True
    )


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "foreign"])
def test_a_damaged_cache_file_is_built_again(
    document: dict[str, Any], write: Write, tmp_path: Path, damage: str
) -> None:
    file, cache = write(document), tmp_path / "cache"
    built = load_target(file, cache=cache)
    (stored,) = cache.iterdir()
    content = bytearray(stored.read_bytes())
    content[len(content) // 2] ^= 0xFF
    damaged = {"truncated": content[:-100], "flipped": content, "empty": b"", "foreign": b"not a zip archive"}
    stored.write_bytes(bytes(damaged[damage]))
    assert_same(load_target(file, cache=cache), built)
    size = stored.stat().st_size
    assert size == len(content)


def test_many_may_build_at_once(document: dict[str, Any], write: Write, tmp_path: Path) -> None:
    file, cache = write(document), tmp_path / "cache"
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        targets = list(pool.map(lambda _: load_target(file, cache=cache), range(8)))
    for target in targets:
        assert_same(target, targets[0])
    assert len(list(cache.iterdir())) == 1


def test_a_cache_file_that_was_changed_by_hand_is_built_again_and_told(
    document: dict[str, Any], write: Write, tmp_path: Path
) -> None:
    file, cache = write(document), tmp_path / "cache"
    built = load_target(file, cache=cache)
    (stored,) = cache.iterdir()
    with np.load(stored) as opened:
        arrays = dict(opened.items())
    np.savez(stored, **(arrays | {"triangles_m": 1.1 * arrays["triangles_m"]}))
    with pytest.warns(UserWarning, match="was changed after it was built"):
        assert_same(load_target(file, cache=cache), built)
    assert load_target(file, cache=cache).content_digest == built.content_digest, "the file is right again"


def test_a_cache_file_that_was_changed_with_its_digest_has_another_content(
    document: dict[str, Any], write: Write, tmp_path: Path
) -> None:
    file, cache = write(document), tmp_path / "cache"
    built = load_target(file, cache=cache)
    (stored,) = cache.iterdir()
    arrays = store.read(stored)
    assert arrays is not None
    del arrays[store.DIGEST]
    store.write(stored, store.with_digest(arrays | {"triangles_m": 1.1 * arrays["triangles_m"]}))
    forged = load_target(file, cache=cache)
    assert forged.digest == built.digest
    assert forged.content_digest != built.content_digest


def test_a_cache_that_cannot_be_written_is_done_without(
    document: dict[str, Any], write: Write, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    assert load_target(write(document), cache=tmp_path / "file").name == "brick"


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"RPOD_CACHE": "a", "XDG_CACHE_HOME": "b"}, "a"),
        ({"XDG_CACHE_HOME": "b"}, "b/rpod"),
        ({}, ".cache/rpod"),
    ],
)
def test_the_environment_names_the_cache(
    *,
    document: dict[str, Any],
    write: Write,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    variables: dict[str, str],
    folder: str,
) -> None:
    for name in ("RPOD_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": ".", **variables}.items():
        monkeypatch.setenv(name, str(tmp_path / value))
    load_target(write(document))
    assert len(list((tmp_path / folder).glob("sealed-*.npz"))) == 1


def test_a_cold_start_without_open3d_says_what_to_install(
    document: dict[str, Any], write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("build.arrays", "build.interior", "build.pieces", "mesh.simplification", "visibility"):
        monkeypatch.delitem(sys.modules, f"rpod_target.{module}", raising=False)
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(TargetError, match=r"install rpod\[target\]"):
        load_target(write(document), cache=tmp_path / "cache")


def replaced(document: dict[str, Any], field: str, value: Any) -> dict[str, Any]:
    """Return the document with the field of a dotted path set, or taken out where the value is MISSING."""
    *path, last = [int(key) if key.isdigit() else key for key in field.split(".")]
    node: Any = document
    for key in path:
        node = node[key]
    if value is MISSING:
        del node[last]
    else:
        node[last] = value
    return document


@pytest.mark.parametrize(
    ("change", "value", "field", "reason"),
    [
        ("parts.0.material", "gold", "parts.0.material", "material 'gold' is unknown; known are paint, foil"),
        ("parts.0.size_m.1", 0.0, "parts.0.size_m.1", "greater than 0"),
        ("parts.0.size_m.1", -1.0, "parts.0.size_m.1", "greater than 0"),
        ("parts.0.size_m.1", float("nan"), "parts.0.size_m.1", "finite number"),
        ("parts.0.colour", "red", "parts.0.colour", "is not a known field"),
        ("parts.0.shape", "sphere", "parts.0", "'sphere'"),
        ("parts.0.shape", MISSING, "parts.0", "shape"),
        ("parts", [], "parts", "needs 1 at least"),
        ("colour", "red", "colour", "is not a known field"),
        ("name", MISSING, "name", "is missing"),
        ("inertia_kg_m2", MISSING, "inertia_kg_m2", "mass_kg or density_kg_m3"),
        ("centre_of_mass_m", MISSING, "centre_of_mass_m", "mass_kg or density_kg_m3"),
        ("materials.paint.diffuse", 1.5, "materials.paint.diffuse", "less than or equal to 1"),
        ("distance_field.spacing_m", 0.0, "distance_field.spacing_m", "greater than 0"),
        ("distance_field.spacing_m", 1e-4, "distance_field.spacing_m", "at most 3e+07"),
        ("inertia_kg_m2.0.1", 0.1, "inertia_kg_m2", "not symmetric"),
        ("inertia_kg_m2.0.0", -2.0, "inertia_kg_m2", "not positive definite"),
        ("inertia_kg_m2.0.0", 8.0, "inertia_kg_m2", "triangle inequality"),
        ("symmetries", [{"axis": [0, 0, 0], "order": 2}], "symmetries.0.axis", "must not be zero"),
        ("tolerance_m", 2.0, "tolerance_m", "10% of the longest side: it is in metres, not in millimetres"),
        ("frames", {"a b": {"translation_m": [0, 0, 0]}}, "frames.a b", "is 'a b'; needs a letter, then"),
    ],
)
def test_a_wrong_field_is_named_with_the_reason(
    *,
    document: dict[str, Any],
    write: Write,
    cache: Path,
    change: str,
    value: Any,
    field: str,
    reason: str,
) -> None:
    file = write(replaced(document, change, value))
    with pytest.raises(TargetError) as caught:
        load_target(file, cache=cache)
    assert caught.value.source == str(file)
    assert caught.value.field == field
    assert reason in caught.value.reason
    assert "\n" not in str(caught.value)


def test_two_parts_of_one_name_are_refused(build: Build) -> None:
    part = {"shape": "box", "size_m": [1.0, 1.0, 1.0], "name": "twin"}
    with pytest.raises(TargetError, match="two parts are named 'twin'"):
        build(part, part)


def test_an_unknown_sector_material_is_named(build: Build) -> None:
    prism = {
        "shape": "prism",
        "sides": 6,
        "circumradius_m": 1.0,
        "length_m": 1.0,
        "top_materials": ["paint", "tin"],
    }
    with pytest.raises(TargetError, match=r"parts\.0\.top_materials\.1: material 'tin' is unknown"):
        build(prism)


def test_a_missing_mesh_is_named(build: Build) -> None:
    with pytest.raises(TargetError, match=r"parts\.0\.file: mesh .*hull\.stl cannot be read \(No such file"):
        build({"shape": "mesh", "file": "hull.stl", "metres_per_unit": 1.0})


def test_a_mesh_needs_one_scale(build: Build) -> None:
    for scales in ({}, {"metres_per_unit": 1.0, "longest_side_m": 1.0}):
        with pytest.raises(TargetError, match=r"parts\.0: needs either longest_side_m or metres_per_unit"):
            build({"shape": "mesh", "file": "hull.stl", **scales})


@pytest.mark.parametrize("share", [0.0, float("nan")], ids=["without size", "not a number"])
def test_a_mesh_that_cannot_be_used_is_refused(
    build: Build, write_stl: Callable[[str, Any], Path], share: float
) -> None:
    write_stl("hull.stl", share * build().triangles_m)
    with pytest.raises(TargetError, match=r"parts\.0\.file: hull\.stl (contains no|has 12 of 12) triangle"):
        build({"shape": "mesh", "file": "hull.stl", "metres_per_unit": 1.0})


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(TargetError, match=r"'mokup': is unknown \(did you mean mockup\?\); known") as caught:
        load_target("mokup")
    for name in shipped_targets():
        assert name in str(caught.value)


def test_a_cad_file_in_place_of_a_target_is_refused_with_the_command_that_makes_one() -> None:
    with pytest.raises(TargetError, match=r"body\.STL: is a CAD file, .*'rpod target new body\.STL' writes"):
        load_target("body.STL")


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"parts: [", "line 1, column 9"), (b"\xff\xfe\x00", "UTF-8"), (b"just text", "named fields")],
)
def test_an_unreadable_file_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    file = tmp_path / "target.yaml"
    file.write_bytes(content)
    with pytest.raises(TargetError, match=reason) as caught:
        load_target(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TargetError, match="No such file"):
        load_target(tmp_path / "target.yaml")


def test_a_pipe_is_no_target_and_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "target.yaml")
    for name in (tmp_path / "target.yaml", tmp_path):
        with pytest.raises(TargetError, match="is no file; give"):
            load_equivalence(name)


def test_a_name_that_no_file_can_have_is_refused_in_one_short_line():
    with pytest.raises(TargetError, match="is no name of a target") as refused:
        load_target("a" * 100_000)
    assert len(str(refused.value)) < 200
