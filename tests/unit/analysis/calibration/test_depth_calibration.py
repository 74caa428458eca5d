"""Calibration from logs: what was put into the frames is found again, on other frames too."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation
from synthetic_log import T_CHASER_SENSOR, SyntheticRun

from rpod.calibrate.background import background_command
from rpod.calibrate.depth import calibrate_command
from rpod_analysis import open_log
from rpod_analysis.calibration.depth_calibration import evidence, fit, range_bins
from rpod_analysis.calibration.depth_samples import DepthSamples, collect
from rpod_analysis.errors import CalibrationError
from rpod_pose.pmd.other_things import PmdFrames
from rpod_pose.surroundings.known import known_parts
from rpod_schemas.config.base import load
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.pmd.depth_calibration import DepthCalibration, Harmonic, unambiguous_range_m
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

HERTZ = 20.013e6
PMD = PmdConfig(camera=Camera(width=118, height=96, fx=228.0, fy=231.0, cx=58.5, cy=47.5))
"""A third of the pixels each way, so that the logs are made in a moment."""
FOLDED = PMD.camera.model_copy(update={"distortion": np.array([-9.0, 0.0, 0.0, 0.0, 0.0])})
WAVE_M = unambiguous_range_m(HERTZ) / (2.0 * np.pi) * PMD.pixel.wiggling_share
"""Amplitude of the error of a third harmonic h3: h3 c / 4 pi f."""


def inwards(time_s):
    turn = Rotation.from_euler("ZYX", [12.0, 65.0, 5.0], degrees=True)
    return make_pose(rotation=turn, translation_m=(0.05, 0.0, 7.2 - 2.4 * time_s))


def outwards(time_s):
    turn = Rotation.from_euler("ZYX", [40.0, 110.0 + 6.0 * time_s, -20.0], degrees=True)
    return make_pose(rotation=turn, translation_m=(-0.1, 0.1, 2.0 + 2.1 * time_s))


def turned_away(_time_s):
    return make_pose(translation_m=(0.0, 0.0, -5.0))


def wall(_T_sensor_target, _number):
    shape = PMD.camera.height, PMD.camera.width
    return np.full(shape, 3.0, np.float32), np.full(shape, 900, np.uint16)


def waiting(_time_s):
    return inwards(1.0)


def write(path, pose, *, seed, **changes):
    emulator = PmdEmulator(PMD, load_target("mockup"), seed=seed)

    def render(T_sensor_target, number):
        exposure = emulator.expose([T_sensor_target] * 4, sun_W_m2=np.zeros(3), frame=number)
        return exposure.depth_m, exposure.amplitude

    run = {
        "duration_s": 2.4,
        "rate_hz": 12.0,
        "truth_rate_hz": 125.0,
        "camera": PMD.camera,
        "target": "mockup",
        "info": PMD.info(),
    }
    return SyntheticRun(**(run | {"render": render, "pose": pose} | changes)).write(path)


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibration")
    return write(folder / "in.mcap", inwards, seed=1), write(folder / "out.mcap", outwards, seed=2)


def samples_of(*paths, config=None):
    opened = [open_log(path) for path in paths]
    try:
        return collect(opened, "pmd", config)
    finally:
        for log in opened:
            log.__exit__(None, None, None)


@pytest.fixture(scope="module")
def samples(logs):
    return samples_of(logs[0]), samples_of(logs[1])


@pytest.fixture(scope="module")
def calibration(samples):
    return fit(samples[0])


def test_the_third_harmonic_of_the_emulator_is_found_with_its_sign(calibration):
    wave = calibration.harmonics[0]
    assert (wave.order, wave.modulation_frequency_hz) == (4, HERTZ)
    assert wave.sin_m == pytest.approx(-WAVE_M, abs=1.5e-3)
    assert abs(wave.cos_m) < 1.5e-3
    assert 0.0 < wave.sigma_m < 1e-3
    assert abs(calibration.offset_m) < 2e-3


def test_another_motion_with_other_noise_is_left_with_less_bias_than_a_calibrated_camera(
    samples, calibration
):
    other = evidence(samples[1], calibration)
    assert other.bias_before_m > 0.02
    assert other.bias_after_m < WAVE_M * 0.005 / PMD.pixel.wiggling_share / np.sqrt(2.0)


def test_several_logs_make_one_calibration(logs, calibration):
    both = fit(samples_of(*logs))
    assert both.evidence.logs == ("in.mcap", "out.mcap")
    assert both.evidence.frames > calibration.evidence.frames
    assert both.evidence.range_m[0] < 2.0
    assert both.evidence.range_m[1] > 6.5


def test_logs_at_one_range_are_refused(tmp_path):
    path = write(tmp_path / "still.mcap", waiting, seed=3, duration_s=1.0)
    with pytest.raises(CalibrationError, match=r"cover \d of the 8 parts of a wave of 1\.87 m"):
        fit(samples_of(path))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"with_truth": False}, "no truth in the log"),
        ({"info": None}, "neither pmd/info nor the configuration gives modulation_frequency_hz"),
        (
            {"name": "nose"},
            "called 'pmd'; its sensors are nose .pmd.: give --camera nose",
        ),
        ({"target": None}, "names the target"),
        ({"target": "no-such-target"}, "no-such-target"),
        ({"camera": FOLDED}, "the lens distortion has no inverse"),
        ({"truth_gaps_s": ((-0.001, 9.0),)}, "no frame of 'pmd' has truth"),
        (
            {"pose": turned_away, "render": wall},
            "no frame of 'pmd' shows a face of the target at the true pose; check",
        ),
    ],
)
def test_a_log_that_lacks_something_is_refused_by_its_name(tmp_path, changes, reason):
    changes = {"pose": inwards} | changes
    path = write(tmp_path / "poor.mcap", seed=3, duration_s=0.2, **changes)
    with pytest.raises(CalibrationError, match=reason) as caught:
        samples_of(path)
    assert "poor.mcap" in str(caught.value)


def test_a_configuration_gives_the_target_and_the_mount_that_a_log_lacks(tmp_path):
    named, bare = (
        write(tmp_path / name, inwards, seed=3, duration_s=0.2, **changes)
        for name, changes in (("named.mcap", {}), ("bare.mcap", {"target": None}))
    )
    config = EstimatorConfig(target="mockup", sensors=(PmdInput(),))
    np.testing.assert_array_equal(samples_of(bare, config=config).error_m, samples_of(named).error_m)
    nearer = T_CHASER_SENSOR * make_pose(translation_m=(0.0, 0.0, 0.1))
    config = config.model_copy(update={"sensors": (PmdInput(T_chaser_sensor=nearer),)})
    shorter_m = samples_of(named).true_m.min() - samples_of(bare, config=config).true_m.min()
    assert shorter_m == pytest.approx(0.1, abs=0.02)


def test_a_configuration_gives_the_frequency_that_a_log_lacks(tmp_path):
    log = write(tmp_path / "bare.mcap", inwards, seed=3, duration_s=0.2, info=None)
    config = EstimatorConfig(target="mockup", sensors=(PmdInput(modulation_frequency_hz=(HERTZ,)),))
    assert samples_of(log, config=config).modulation_frequency_hz == (HERTZ,)


@pytest.mark.parametrize("truth_rate_hz", [10.0, 100.0])
def test_the_truth_may_come_at_any_rate(tmp_path, truth_rate_hz):
    path = write(tmp_path / "slow.mcap", waiting, seed=3, duration_s=1.0, truth_rate_hz=truth_rate_hz)
    assert samples_of(path).frames > 6


# --- the fit alone ---


def invented(
    *waves, count=20_000, offset_m=0.0, noise_m=0.01, hertz=(HERTZ,), seed=5, farthest_m=7.0, in_frame=100
):
    rng = np.random.default_rng(seed)
    truth = DepthCalibration(modulation_frequency_hz=hertz, offset_m=offset_m, harmonics=waves)
    true_m = rng.uniform(1.5, farthest_m, count)
    error_m = truth.error_m(true_m) + rng.normal(0.0, noise_m, count)
    return DepthSamples(
        modulation_frequency_hz=hertz,
        target="mockup",
        logs=("invented",),
        true_m=true_m,
        error_m=error_m,
        frame=np.arange(count) // in_frame,
    )


def wave(order, cos_m, sin_m, hertz=HERTZ):
    return Harmonic(modulation_frequency_hz=hertz, order=order, cos_m=cos_m, sin_m=sin_m)


def test_offset_and_all_waves_are_found_within_their_standard_errors():
    waves = wave(4, 0.01, -0.03), wave(2, 0.003, 0.0), wave(8, 0.0, 0.002)
    found = fit(invented(*waves, offset_m=0.04))
    assert found.offset_m == pytest.approx(0.04, abs=5.0 * found.offset_sigma_m)
    assert [item.order for item in found.harmonics] == [4, 2, 8]
    for item, true in zip(found.harmonics, waves, strict=True):
        assert item.cos_m == pytest.approx(true.cos_m, abs=5.0 * item.sigma_m)
        assert item.sin_m == pytest.approx(true.sin_m, abs=5.0 * item.sigma_m)


@pytest.mark.parametrize(("count", "in_frame"), [(1600, 100), (4000, 20)])
def test_standard_errors_are_what_repeated_fits_scatter_by(count, in_frame):
    fits = [
        fit(invented(wave(4, 0.0, -0.03), count=count, seed=seed, in_frame=in_frame)) for seed in range(40)
    ]
    over_sigma = [
        error / sigma
        for found in fits
        for error, sigma in (
            (found.offset_m, found.offset_sigma_m),
            (found.harmonics[0].cos_m, found.harmonics[0].sigma_m),
            (found.harmonics[0].sin_m + 0.03, found.harmonics[0].sigma_m),
        )
    ]
    assert 0.8 < np.sqrt(np.mean(np.square(over_sigma))) < 1.15


def test_too_few_frames_for_the_standard_errors_are_refused():
    few = invented(wave(4, 0.0, -0.03), count=1600, in_frame=600)
    with pytest.raises(CalibrationError, match="3 frames show faces of the target, the errors of 3 values"):
        fit(few)
    assert [item.order for item in fit(invented(wave(4, 0.0, -0.03), in_frame=4000)).harmonics] == [4]


def test_frames_that_alone_determine_a_wave_are_refused():
    samples = invented(wave(4, 0.0, -0.03), count=4000)
    still = np.arange(4000) < 2000
    samples.true_m[still] = 3.0
    frame = np.where(still, np.arange(4000) // 200, 10)
    with pytest.raises(CalibrationError, match="a part of the frames alone determines a wave"):
        fit(replace(samples, frame=frame, error_m=np.zeros(4000)))


def test_waves_that_are_not_there_are_left_out():
    assert [item.order for item in fit(invented(wave(4, 0.0, -0.03))).harmonics] == [4]


def test_long_waves_that_are_not_covered_are_left_out():
    found = fit(invented(wave(4, 0.0, -0.03), wave(2, 0.0, 0.01), farthest_m=3.8))
    assert 2 not in [item.order for item in found.harmonics]


def test_a_tenth_of_outliers_changes_little():
    samples = invented(wave(4, 0.0, -0.03))
    samples.error_m[::10] += 0.3
    found = fit(samples)
    assert found.harmonics[0].sin_m == pytest.approx(-0.03, abs=5e-4)
    assert abs(found.offset_m) < 5e-4


def test_two_frequencies_have_a_wave_each():
    hertz = HERTZ, 30e6
    found = fit(invented(wave(4, 0.0, -0.02), wave(4, 0.0, -0.01, 30e6), hertz=hertz))
    heights = {item.modulation_frequency_hz: item.sin_m for item in found.harmonics if item.order == 4}
    assert heights[HERTZ] == pytest.approx(-0.02, abs=1e-3)
    assert heights[30e6] == pytest.approx(-0.01, abs=1e-3)


def test_a_frequency_and_its_half_share_waves_that_count_once():
    hertz = 15e6, 30e6
    found = fit(invented(wave(4, 0.0, -0.02, 15e6), wave(4, 0.0, -0.01, 30e6), hertz=hertz))
    heights = {item.modulation_frequency_hz: item.sin_m for item in found.harmonics if item.order == 4}
    assert heights[15e6] == pytest.approx(-0.02, abs=1e-3)
    assert heights[30e6] == pytest.approx(-0.01, abs=1e-3)


def test_two_frequencies_at_a_ratio_of_four_share_a_further_wave_that_counts_once():
    hertz = HERTZ, 4.0 * HERTZ
    waves = wave(4, 0.0, -0.02), wave(4, 0.0, -0.01, hertz[1]), wave(8, 0.0, 0.004)
    found = fit(invented(*waves, hertz=hertz))
    assert [(item.modulation_frequency_hz, item.order) for item in found.harmonics] == [
        (hertz[0], 4), (hertz[1], 4), (hertz[0], 8),
    ]  # fmt: skip
    assert found.harmonics[2].sin_m == pytest.approx(0.004, abs=1e-3)


def test_a_calibration_of_another_frequency_is_not_checked():
    with pytest.raises(CalibrationError, match="modulation_frequency_hz"):
        evidence(invented(), DepthCalibration(modulation_frequency_hz=(30e6,)))


def test_ranges_tell_bias_before_and_after():
    samples = invented(offset_m=0.05)
    bins = range_bins(samples, fit(samples))
    assert bins[0].from_m == pytest.approx(1.5)
    assert all(abs(part.bias_before_m - 0.05) < 0.005 for part in bins)
    assert all(abs(part.bias_after_m) < 0.005 for part in bins)
    assert all(0.007 < part.noise_m < 0.013 for part in bins)


# --- the file and the command ---


@pytest.mark.parametrize("name", ["found.yaml", "found.json"])
def test_the_estimator_takes_the_file_or_its_content(tmp_path, calibration, name):
    path = calibration.write(tmp_path / name)
    assert load(DepthCalibration, path) == calibration
    assert PmdInput(calibration=str(path)).calibration == calibration
    assert PmdInput(calibration=calibration.model_dump(mode="json")).calibration == calibration
    resolved = PmdInput(calibration=path).model_dump(mode="json")["calibration"]
    assert resolved["harmonics"][0]["order"] == 4, "the log of a run holds the calibration, not its path"


def test_a_wrong_file_is_named_with_its_field(tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text("modulation_frequency_hz: [20.013e+6]\noffset: 1\n")
    with pytest.raises(ValidationError, match=r"calibration\n.*wrong\.yaml: offset"):
        PmdInput(calibration=path)
    with pytest.raises(ValidationError, match=r"calibration\n.*cannot be read"):
        PmdInput(calibration=tmp_path / "none.yaml")


def test_an_error_that_cannot_be_undone_is_refused():
    with pytest.raises(ValueError, match="can be corrected"):
        DepthCalibration(modulation_frequency_hz=(HERTZ,), harmonics=(wave(8, 0.2, 0.0),))


def test_the_command_writes_the_file_and_checks_it_on_another_log(logs, tmp_path, capsys):
    out = tmp_path / "pmd.yaml"
    assert calibrate_command(logs[:1], camera="pmd", config=None, check=None, out=out, as_json=False) == 0
    assert "order 4 at 20.013 MHz" in capsys.readouterr().out
    assert calibrate_command(logs[1:], camera="pmd", config=None, check=out, out=None, as_json=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["file"] is None
    assert told["evidence"]["logs"] == ["out.mcap"]
    assert told["evidence"]["bias_after_m"] < 0.005
    assert told["evidence"]["bias_before_m"] > 0.02
    assert {"from_m", "bias_before_m", "bias_after_m", "pixels"} <= told["ranges"][0].keys()


def test_the_command_fails_with_one_line(tmp_path, capsys):
    missing = [tmp_path / "none.mcap"]
    assert calibrate_command(missing, camera="pmd", config=None, check=None, out=None, as_json=False) == 1
    assert (
        calibrate_command(missing, camera="pmd", config=None, check=missing[0], out=None, as_json=False) == 2
    )
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_the_background_of_a_log_without_the_target_is_written_for_the_estimator(tmp_path, logs, capsys):
    out = tmp_path / "known.yaml"
    assert background_command(logs[0], out=out, as_json=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["sensors"]["pmd"]["frames"] > 10
    assert known_parts(out, "pmd", PmdFrames()).background.range_m.shape == (96, 118)
