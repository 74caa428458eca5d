"""``rpod calibrate``: its verbs on logs and images, their files, their errors, and the form of before."""

import json

import cv2
import numpy as np
import pytest
import yaml
from mcap.writer import Writer
from scipy.spatial.transform import Rotation
from synthetic_log import T_CHASER_SENSOR, TINY_CAMERA, Frame, SyntheticRun, see_depth, see_points
from typer.testing import CliRunner

from rpod.__main__ import app
from rpod_motion.truth_error import TruthError
from rpod_schemas.config.base import load
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.config.motion import TruthErrorConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_target import load_target

SIGMA = np.array([1e-3] * 3 + [np.radians(0.1)] * 3)


def swaying(time_s):
    turn = np.radians(40.0) * np.sin([0.9 * time_s, 1.3 * time_s + 1.0, 1.1 * time_s + 2.0])
    position_m = [0.2 * np.sin(1.1 * time_s), 0.2 * np.cos(0.9 * time_s), 3.0 + 0.4 * np.sin(0.7 * time_s)]
    return make_pose(rotation=Rotation.from_rotvec(turn), translation_m=position_m)


def seen(number, _time_s):
    noise = SIGMA * np.random.default_rng((3, number)).standard_normal(6)
    return Frame(attitude_rad=noise[3:], position_m=noise[:3], covariance=np.diag(SIGMA**2))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    error = TruthErrorConfig(sigma_position_m=2e-4, sigma_attitude_deg=0.02, correlation_s=0.0)
    run = SyntheticRun(
        duration_s=12.0,
        rate_hz=20.0,
        pose=swaying,
        frame=seen,
        truth_error=TruthError(error, seed=1, rate_hz=250.0),
    )
    return run.write(tmp_path_factory.mktemp("calibrate") / "sway.mcap")


def rpod(*arguments):
    return CliRunner().invoke(app, ["calibrate", *map(str, arguments)])


def test_the_mount_is_found_and_a_driver_takes_its_file(log, tmp_path):
    file = tmp_path / "mount.yaml"
    found = rpod("mount", log, "--out", file)
    assert found.exit_code == 0, found.output
    assert "holder" in found.stdout
    assert "filtered estimates" in found.stdout
    mount = DriverConfig(kind="pmd", name="pmd", T_chaser_sensor=file).T_chaser_sensor
    evidence = yaml.safe_load(file.read_text())["evidence"]
    sigma_m = np.sqrt(np.trace(np.array(evidence["covariance"])[:3, :3]))
    off_m = np.linalg.norm(mount.translation - T_CHASER_SENSOR.translation)
    assert off_m < 4.0 * sigma_m < 0.2
    apart = (mount.rotation * T_CHASER_SENSOR.rotation.inv()).magnitude()
    assert np.degrees(apart) < 0.2
    assert PmdInput(T_chaser_sensor=file).T_chaser_sensor is not None


def test_the_clock_is_found_and_its_file_is_a_source(log, tmp_path):
    file = tmp_path / "source.yaml"
    found = rpod("clock", log, "--out", file, "--json")
    assert found.exit_code == 0, found.output
    told = json.loads(found.stdout)
    assert abs(told["found_offset_s"]) < 4.0 * told["sigma_s"] < 0.01
    assert PmdInput(source=file).source.clock_offset_s == pytest.approx(told["clock_offset_s"])
    assert file.read_text().startswith("# clock")


def test_a_log_without_truth_and_a_sensor_that_is_not_there_are_refused(log, tmp_path):
    blind = SyntheticRun(duration_s=1.0, with_truth=False).write(tmp_path / "blind.mcap")
    assert "no truth in the log" in rpod("mount", blind).stderr
    refused = rpod("clock", log, "--sensor", "lidar")
    assert refused.exit_code == 1
    assert "no frames of 'lidar'; it has pmd: choose with --sensor" in refused.stderr


@pytest.fixture
def empty_folder(tmp_path, monkeypatch):
    """Return the folder in which a command runs and writes."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


BOARD = ("--pattern", "7x5", "--square-mm", "30")
NO_CAMERA = "no frames of a PMD camera called 'pmd'; its sensors are lidar (lidar): log a PMD camera; "
NO_FRAME = "no frame of any sensor in the log; run the sensor's driver beside the logger"
NO_TRUTH = "no truth in the log (truth/odometry); let the robots or a motion capture system publish it"


@pytest.fixture(scope="module")
def poor_logs(tmp_path_factory):
    """Return logs by what they lack, and a folder without an image."""
    folder = tmp_path_factory.mktemp("poor")
    (folder / "no_image").mkdir()
    with (folder / "empty.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    (folder / "no_log.mcap").write_bytes(b"")
    target = load_target("mockup")
    scans, images = see_points(target), see_depth(target, TINY_CAMERA)
    SyntheticRun(kind="lidar", name="lidar", duration_s=1.0, render=scans).write(folder / "lidar.mcap")
    SyntheticRun(duration_s=1.0, with_truth=False, render=images).write(folder / "blind.mcap")
    SyntheticRun(duration_s=0.5, render=images).write(folder / "short.mcap")
    return folder


@pytest.mark.parametrize(
    ("verb", "log", "told"),
    [
        ("depth", "lidar.mcap", NO_CAMERA + "for a LIDAR, 'rpod driver check' with --target and truth"),
        ("depth", "empty.mcap", NO_FRAME),
        ("depth", "blind.mcap", NO_TRUTH),
        ("depth", "short.mcap", "gives modulation_frequency_hz; let the camera's driver publish its info"),
        ("depth", "no_log.mcap", "is not an MCAP log"),
        ("depth", "no_image", "no .mcap file in this folder"),
        ("background", "empty.mcap", NO_FRAME),
        (
            "background",
            "short.mcap",
            "6 frames of 'pmd', needs 10 to know the noise of each pixel: log for lon",
        ),
        ("background", "no_log.mcap", "is not an MCAP log"),
        (
            "mount",
            "lidar.mcap",
            "11 poses of the sensor and 255 of the truth, needs 30 of each: log the motion",
        ),
        ("mount", "empty.mcap", NO_FRAME),
        ("mount", "blind.mcap", NO_TRUTH),
        ("mount", "no_log.mcap", "is not an MCAP log"),
        (
            "clock",
            "short.mcap",
            "6 poses of the sensor and 130 of the truth, needs 30 of each: log the motion",
        ),
        ("clock", "empty.mcap", NO_FRAME),
        ("clock", "blind.mcap", NO_TRUTH),
        ("camera", "lidar.mcap", NO_CAMERA + "a LIDAR has no lens"),
        ("camera", "empty.mcap", NO_FRAME),
        ("camera", "short.mcap", "was found in 0 of 6 images, needs 6: check --pattern, light"),
        ("camera", "no_image", "no image: a folder needs images (PNG, JPEG, TIFF, BMP or PGM)"),
    ],
)
def test_a_log_that_a_verb_cannot_use_gets_one_sentence_with_the_remedy(
    poor_logs, verb, log, told, empty_folder
):
    refused = rpod(verb, poor_logs / log, *(BOARD if verb == "camera" else ()))
    assert refused.exit_code == 1, refused.output
    assert told in refused.stderr
    assert refused.stderr.startswith(f"rpod calibrate {verb}: ")
    assert len(refused.stderr.strip().splitlines()) == 1
    assert not refused.stdout
    assert not list(empty_folder.iterdir())  # nothing is written


def test_a_background_of_a_log_with_truth_is_written_with_a_warning(poor_logs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    learned = rpod("background", poor_logs / "lidar.mcap")
    assert learned.exit_code == 0, learned.output
    assert "the log has truth; a target in view" in learned.stderr
    assert "lidar: 11 frames" in learned.stdout
    assert rpod("background", poor_logs / "blind.mcap").stderr == ""


def test_the_form_without_a_verb_still_calibrates_distances_and_says_so(log):
    old, new = rpod(log, "--camera", "tof"), rpod("depth", log, "--camera", "tof")
    notice, _, rest = old.stderr.partition("\n")
    assert "is now 'rpod calibrate depth LOG'" in notice
    assert rest == new.stderr
    assert old.exit_code == new.exit_code == 1


CAMERA = Camera(
    width=320, height=240, fx=260.0, fy=262.0, cx=158.0, cy=121.0, distortion=[-0.2, 0.05, 0, 0, 0]
)


def checkerboard(pose):
    """Return an image of a board of 8 x 6 squares of 50 mm: its squares drawn fine, then projected."""
    rays = cv2.undistortPoints(
        np.indices((CAMERA.width, CAMERA.height)).reshape(2, -1).T[:, None].astype(float),
        CAMERA.K,
        CAMERA.distortion,
    )[:, 0]
    rays = np.column_stack((rays, np.ones(len(rays))))
    normal = pose.rotation.apply([0.0, 0.0, 1.0])
    points = rays * ((normal @ pose.translation) / (rays @ normal))[:, None]
    board = (pose.inv().apply(points)[:, :2] + 0.05) / 0.05
    black = np.floor(board).sum(axis=1) % 2 == 0
    on = (board > 0).all(axis=1) & (board < [8, 6]).all(axis=1)
    image = np.where(on & black, 40.0, 220.0).reshape(CAMERA.width, CAMERA.height).T
    noise = np.random.default_rng(1).normal(0.0, 2.0, image.shape)
    return cv2.GaussianBlur(image, (3, 3), 0.6) + noise


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards")
    generator = np.random.default_rng(3)
    for number in range(14):
        turn = Rotation.from_euler("XYZ", generator.uniform([-35, -35, -20], [35, 35, 20]), degrees=True)
        centre_m = np.array([*generator.uniform([-0.16, -0.1], [0.16, 0.1]), generator.uniform(0.6, 0.8)])
        pose = make_pose(rotation=turn, translation_m=centre_m - turn.apply([0.15, 0.10, 0.0]))
        cv2.imwrite(str(folder / f"{number:02}.png"), checkerboard(pose).clip(0, 255).astype(np.uint8))
    return folder


def test_intrinsics_are_found_from_a_checkerboard_and_the_estimator_takes_the_file(boards, tmp_path):
    file = tmp_path / "camera.yaml"
    found = rpod("camera", boards, "--pattern", "7x5", "--square-mm", "50", "--out", file, "--json")
    assert found.exit_code == 0, found.output
    told = json.loads(found.stdout)
    camera = PmdInput(camera=yaml.safe_load(file.read_text())).camera
    assert load(Camera, file).fx == camera.fx
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(camera, name) == pytest.approx(
            getattr(CAMERA, name), abs=4.0 * told["sigma"][name] + 0.3
        )
    assert told["rms_px"] < 0.5  # a pixel is drawn by one ray
    assert told["found"] >= 10


def test_a_board_that_is_not_found_and_a_wrong_pattern_are_told(tmp_path):
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((60, 80), 100, np.uint8))
    refused = rpod("camera", tmp_path, "--pattern", "9x9", "--square-mm", "50")
    assert refused.exit_code == 1
    assert "found in 0 of 1 images" in refused.stderr
    assert rpod("camera", tmp_path, "--pattern", "9", "--square-mm", "50").exit_code == 2
