"""How far a target's edges err in a camera's images: the factor, its measurement, and its file."""

import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from rpod.target.errors_command import errors_command, with_block
from rpod_analysis.target_check import camera_errors
from rpod_analysis.target_check.camera_errors import (
    CameraErrors,
    PoseErrors,
    measure_camera_errors,
    repainted,
)
from rpod_estimator.estimator import Estimator
from rpod_pose.methods import ready_methods
from rpod_pose.pmd.methods import ideal_frames
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput, PmdInput
from rpod_schemas.poses import make_pose
from rpod_target import Target, TargetError, load_target

MOCKUP = load_target("mockup")
DOCUMENT = {
    "name": "block",
    "mass_kg": 10.0,
    "materials": {"paint": {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3}},
    "parts": [{"name": "body", "shape": "box", "size_m": [1.0, 0.7, 0.5], "material": "paint"}],
    "distance_field": {"spacing_m": 0.05, "margin_m": 0.3},
    "model_points": 300,
}
FOUND = CameraErrors(2.1, (1.7, 2.6), 118, 1, tried=120, nees=10.0, nees_with=6.0)


def poses(factor: float, *, number: int = 4000, wrong: int = 0) -> PoseErrors:
    """Return errors of which those of edges have the given variance, and some of wrong poses."""
    generator = np.random.default_rng(3)
    roots = generator.standard_normal((2, number, 6, 6))
    others, edges = 0.2 * roots @ roots.transpose(0, 1, 3, 2)
    true = np.linalg.cholesky(others + factor * edges)
    errors = np.einsum("nij,nj->ni", true, generator.standard_normal((number, 6)))
    errors[:wrong] *= 1e3
    return PoseErrors(errors, others, edges)


@pytest.mark.parametrize("factor", [1.5, 3.0, 8.0])
def test_the_factor_of_the_edges_variance_is_found(factor: float) -> None:
    assert poses(factor).factor() == pytest.approx(factor, rel=0.08)


def test_one_wrong_pose_of_a_hundred_hardly_counts() -> None:
    assert poses(3.0, wrong=40).factor() == pytest.approx(3.0, rel=0.2)


def test_a_covariance_that_is_too_large_is_not_made_smaller() -> None:
    assert poses(0.4).factor() == 1.0


def test_errors_beyond_the_largest_factor_have_the_largest_one() -> None:
    assert poses(100.0).factor() == camera_errors.LARGEST


def test_the_interval_holds_the_factor_and_shrinks_with_the_number_of_poses() -> None:
    few = poses(3.0, number=60).interval(np.random.default_rng(1))
    many = poses(3.0, number=1500).interval(np.random.default_rng(1))
    assert many[0] < 3.0 < many[1]
    assert many[1] - many[0] < 0.5 * (few[1] - few[0])


def test_each_part_is_painted_anew_and_its_class_and_shape_stay() -> None:
    painted = repainted(MOCKUP, np.random.default_rng(1))
    before = [MOCKUP.materials[each] for each in MOCKUP.triangle_material]
    after = [painted.materials[each] for each in painted.triangle_material]
    assert [each.looks for each in after] == [each.looks for each in before]
    assert painted.triangles_m is MOCKUP.triangles_m
    ratios = {
        (part, round(now.diffuse / then.diffuse, 6))
        for part, now, then in zip(MOCKUP.triangle_part.tolist(), after, before, strict=True)
        if then.diffuse > 0.0
    }
    assert len({ratio for _, ratio in ratios}) == len(ratios) >= len(MOCKUP.parts)
    assert all(0.0 <= each.diffuse <= 0.95 for each in painted.materials)


def test_the_measurement_follows_from_frames_and_seed_and_not_from_the_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(camera_errors, "FEWEST", 4)
    found = measure_camera_errors(MOCKUP, frames=6, seed=4)
    other = measure_camera_errors(replace(MOCKUP, camera_errors=9.0, tolerance_m=0.01), frames=6, seed=4)
    assert other == found
    assert 4 <= found.frames <= found.tried == 6
    assert found.interval[0] <= found.factor <= found.interval[1]
    assert found.nees_with <= found.nees


def test_too_few_accepted_poses_are_an_error_with_the_remedy() -> None:
    with pytest.raises(
        TargetError, match=r"camera_errors: cannot be measured: 3 of 3 .* ask for more frames"
    ):
        measure_camera_errors(MOCKUP, frames=3)


@pytest.mark.parametrize(
    "before",
    [
        "",
        "camera_errors: {factor: 1.2}  # earlier\n",
        "camera_errors:\n  factor: 1.2\n  interval: [1.0, 1.5]\n",
    ],
)
def test_the_block_of_a_file_is_written_or_replaced_and_the_rest_stays(before: str) -> None:
    text = with_block("name: block  # mine\n" + before + "mass_kg: 10\n", FOUND.block())
    assert text.count("camera_errors") == 1
    assert yaml.safe_load(text) == {
        "name": "block",
        "mass_kg": 10,
        "camera_errors": {"factor": 2.1, "interval": [1.7, 2.6], "frames": 118, "seed": 1},
    }
    assert "# mine" in text


def test_a_file_without_a_last_line_end_gets_one() -> None:
    assert yaml.safe_load(with_block("name: block", FOUND.block()))["camera_errors"]["factor"] == 2.1


def test_a_target_has_the_factor_that_its_file_declares(tmp_path) -> None:
    file = tmp_path / "block.yaml"
    file.write_text(yaml.safe_dump(DOCUMENT))
    plain = load_target(file)
    file.write_text(with_block(file.read_text(), FOUND.block()))
    declared = load_target(file)
    assert (plain.camera_errors, declared.camera_errors) == (None, 2.1)
    assert declared.digest != plain.digest
    assert declared.content == plain.content  # nothing is built anew


def test_a_factor_below_one_is_refused_with_its_limit(tmp_path) -> None:
    file = tmp_path / "block.yaml"
    file.write_text(yaml.safe_dump(DOCUMENT | {"camera_errors": {"factor": 0.5}}))
    with pytest.raises(TargetError, match=r"camera_errors\.factor.* greater than or equal to 1"):
        load_target(file)


def test_the_factor_widens_what_edges_cause_and_no_limit_of_acceptance() -> None:
    pose = make_pose(translation_m=(0.1, 0.0, 4.0))

    def tracked(target: Target) -> object:
        methods = ready_methods(PmdInput(), target, False)
        return methods.tracker.track(ideal_frames(MOCKUP, pose, ())[0], pose)

    plain, wider = tracked(MOCKUP), tracked(replace(MOCKUP, camera_errors=4.0))
    np.testing.assert_allclose(wider.parts.of_model, 4.0 * plain.parts.of_model)
    np.testing.assert_array_equal(wider.parts.white, plain.parts.white)
    np.testing.assert_array_equal(wider.parts.of_sensor, plain.parts.of_sensor)
    np.testing.assert_array_equal(wider.covariance, plain.covariance)


@pytest.mark.parametrize(
    ("sensors", "errors", "factor", "told"),
    [
        ((PmdInput(),), "considered", None, True),
        ((PmdInput(),), "considered", 1.3, False),
        ((PmdInput(),), "inflated", None, False),
        ((LidarInput(),), "considered", None, False),
    ],
)
def test_the_operator_is_told_once_that_nobody_measured_it(sensors, errors, factor, told, caplog) -> None:
    config = EstimatorConfig(target="mockup", sensors=sensors, filter={"errors": errors})
    with caplog.at_level(logging.INFO):
        Estimator(config, replace(MOCKUP, camera_errors=factor))
    lines = [line for line in caplog.messages if "'rpod target errors" in line]
    assert len(lines) == told
    assert all("pmd" in line and MOCKUP.source in line for line in lines)


def test_the_command_writes_what_it_prints(tmp_path, monkeypatch, capsys) -> None:
    file = tmp_path / "block.yaml"
    file.write_text(yaml.safe_dump(DOCUMENT))
    monkeypatch.setattr("rpod.target.errors_command.measure_camera_errors", lambda *_, **__: FOUND)
    assert errors_command(file, frames=120, seed=1, write=True, as_json=True) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["factor"] == load_target(file).camera_errors == 2.1
    assert printed["written"] == str(file)
    assert errors_command(file, frames=120, seed=1, write=False, as_json=False) == 0
    assert FOUND.block() in capsys.readouterr().out


def test_a_target_of_a_name_is_not_written(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert errors_command(Path("mockup"), frames=20, seed=1, write=True, as_json=False) != 0
    assert "leave out --write" in capsys.readouterr().err
