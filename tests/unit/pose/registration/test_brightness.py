"""What an estimator knows of surfaces: classes of brightness, and nothing of the emulator's reflection."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rpod_estimator
import rpod_pose
from rpod_pose.registration.brightness import CLASSES, albedos, spreads
from rpod_target import Material, load_target

SECRETS = re.compile(r"\.(reflectivity|diffuse|f0|roughness|crinkle_deg|crinkle_m)\b")


def looks(**fields):
    plain = {"name": "any", "reflectivity": 0.3, "diffuse": 0.3, "f0": 0.04, "roughness": 0.3}
    return Material(**plain | fields).looks


@pytest.mark.parametrize("package", [rpod_pose, rpod_estimator])
def test_the_estimator_reads_nothing_of_a_material_but_how_it_looks(package):
    files = list(Path(package.__file__).parent.rglob("*.py"))
    assert len(files) > 3
    found = {file.name: SECRETS.findall(file.read_text(encoding="utf-8")) for file in files}
    assert not {name: fields for name, fields in found.items() if fields}


def test_a_material_looks_as_its_file_says_or_as_its_reflectances_let_expect():
    assert looks() == "grey"
    assert looks(reflectivity=0.1) == "dark"
    assert looks(reflectivity=0.8) == "white"
    assert looks(crinkle_deg=3.0) == "mirror"
    assert looks(f0=0.5) == "mirror"
    assert looks(f0=0.5, albedo="white") == "white"


def test_the_shipped_targets_look_like_their_materials():
    seen = {material.name: material.looks for name in ("mockup", "envisat-bulky") for material in
            load_target(name).materials}  # fmt: skip
    assert seen == {
        "panel": "grey", "gold-mli": "mirror", "silver-mli": "mirror", "nose": "white", "dark": "dark",
        "steel": "mirror", "solar-cells": "dark", "aluminium": "mirror",
    }  # fmt: skip


def test_each_triangle_has_the_albedo_of_its_class():
    target = load_target("mockup")
    names = [target.materials[index].looks for index in target.triangle_material]
    np.testing.assert_array_equal(albedos(target), [CLASSES[name].albedo for name in names])
    np.testing.assert_array_equal(spreads(target), [CLASSES[name].sigma_log for name in names])


def test_reflectances_within_a_class_change_nothing_that_the_estimator_expects():
    target = load_target("mockup")
    polished = tuple(replace(m, diffuse=0.5 * m.diffuse, roughness=0.9) for m in target.materials)
    np.testing.assert_array_equal(albedos(replace(target, materials=polished)), albedos(target))


def test_classes_are_known_within_a_wide_factor_and_mirrors_hardly_at_all():
    assert CLASSES["dark"].albedo < CLASSES["grey"].albedo < CLASSES["white"].albedo
    assert min(known.sigma_log for known in CLASSES.values()) >= 0.5
    assert CLASSES["mirror"].sigma_log >= 2.0
