from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numba import typeof
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2
from tests.pmd_frames import frame_of, strange_frames

from rpod_campaign.pmd.world import World, built
from rpod_geometry.rays import RayGrid, cast
from rpod_pose.belief import AMPLITUDE_LEFT_OUT
from rpod_pose.pmd.joint import expected_edges
from rpod_pose.pmd.joint.brightness.amplitude_noise import correlation_px
from rpod_pose.pmd.joint.brightness.patch_renderer import PatchRenderer
from rpod_pose.pmd.joint.depth_points import CoarseRanges, DepthImages, coarse_ranges
from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_pose.pmd.joint.edge_points import (
    LAST_SCALE,
    SCALE,
    EdgeErrors,
    EdgeEvidence,
    EdgeSums,
    add_edge_points,
)
from rpod_pose.pmd.joint.edge_search import CoarsePixels
from rpod_pose.pmd.joint.expected_edges import ALIASED_PX, EdgeSight, expect_edges
from rpod_pose.pmd.joint.fit import DepthErrors, _shares, near_the_pose
from rpod_pose.pmd.joint.frame import JointFrame, _around
from rpod_pose.pmd.joint.tracker import JointTracker
from rpod_pose.pmd.methods import ideal_frames
from rpod_pose.ports import Registration
from rpod_pose.registration.field_alignment import FieldEvidence
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.normal_equations import no_sums
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import BeliefLevel, Camera, PmdFrame, Source
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

MOCKUP, HEXAGON = load_target("mockup"), load_target("hexagonal-body")
CAMERA = PmdConfig().model_copy(
    update={"pixel": PmdConfig().pixel.model_copy(update={"wiggling_share": 0.0})}
)
CALIBRATED_WIGGLING = 0.005
"""Share of the wiggling that a calibration leaves."""
SUN_W_M2 = np.array((500.0, -600.0, -900.0))
TRACKER = JointTracker(JointConfig(), MOCKUP)
TRUTH = make_pose(
    rotation=FACING * Rotation.from_euler("ZYX", (8.0, -12.0, 25.0), degrees=True),
    translation_m=(0.1, -0.05, 3.5),
)


def frame(
    T: RigidTransform = TRUTH, *, number: int = 1, config: PmdConfig = CAMERA, target: object = MOCKUP
) -> PmdFrame:
    exposure = PmdEmulator(config, target, seed=3).expose([T] * 4, sun_W_m2=SUN_W_M2, frame=number)  # type: ignore[arg-type]
    return PmdFrame(
        stamp_ns=0,
        frame_id="",
        depth_m=exposure.depth_m.copy(),
        amplitude=exposure.amplitude.copy(),
        camera=config.camera,
    )


FRAME = frame()


def nees_of(found: Registration, truth: RigidTransform) -> float:
    assert found.T_sensor_target is not None
    turn = (found.T_sensor_target.rotation * truth.rotation.inv()).as_rotvec()
    e = np.concatenate((found.T_sensor_target.translation - truth.translation, turn))
    return float(e @ np.linalg.solve(found.covariance, e))


def off(T: RigidTransform, deg: float, m: float, seed: int = 0) -> RigidTransform:
    turn, shift = Rotation.random(2, rng=np.random.default_rng(seed)).apply((1.0, 0.0, 0.0))
    return make_pose(
        rotation=Rotation.from_rotvec(np.radians(deg) * turn) * T.rotation,
        translation_m=T.translation + m * shift,
    )


def assert_within(errors: tuple[float, float], deg: float, m: float) -> None:
    """Each of the errors in attitude, deg, and position, m, has a limit of its own."""
    assert errors[0] < deg
    assert errors[1] < m


def error(registration: Registration, T: RigidTransform = TRUTH) -> tuple[float, float]:
    found = registration.T_sensor_target
    assert found is not None
    turn = (found.rotation * T.rotation.inv()).magnitude()
    return float(np.degrees(turn)), float(np.linalg.norm(found.translation - T.translation))


@pytest.mark.parametrize(("deg", "m"), [(0.2, 0.002), (2.0, 0.03), (10.0, 0.2)])
def test_a_prediction_near_or_far_leads_to_a_quarter_of_a_degree_and_5_mm(deg: float, m: float) -> None:
    for seed in range(4):
        registration = TRACKER.track(FRAME, off(TRUTH, deg, m, seed))
        assert not registration.belief.reason
        assert 0.9 < registration.inlier_share <= 1.0
        assert registration.source is Source.PMD_JOINT
        assert_within(error(registration), 0.25, 0.005)


def test_a_good_prediction_takes_fewer_steps() -> None:
    assert TRACKER.track(FRAME, TRUTH).iterations < TRACKER.track(FRAME, off(TRUTH, 4.0, 0.1)).iterations


def test_a_good_prediction_is_not_searched_around_for_what_depth_is_left() -> None:
    tracker = JointTracker(JointConfig(), MOCKUP, calibrated=True)
    whole, left = [], []
    for number in range(8):
        T = off(make_pose(rotation=TRUTH.rotation, translation_m=(0.1, -0.05, 5.5)), 15.0, 0.1, 200 + number)
        seen, start = frame(T, number=number), off(T, 0.1, 0.002, number)
        whole.append(error(tracker.track(seen, start), T)[0])
        left.append(error(tracker.track(without_depth(seen, 0.6, number), start), T)[0])
    assert np.mean(left) < 1.15 * np.mean(whole)
    assert max(left) < 0.35


def without_depth(seen: PmdFrame, share: float, seed: int) -> PmdFrame:
    """Return a frame whose depth is lost in patches."""
    lost = np.random.default_rng(seed).random((12, 12)) < share
    rows, columns = (np.arange(size) * 12 // size for size in seen.depth_m.shape)
    depth_m = np.where(lost[np.ix_(rows, columns)], np.float32(np.nan), seen.depth_m)
    return seen.model_copy(update={"depth_m": depth_m})


def test_edges_go_on_alone_where_all_depth_is_lost() -> None:
    errors = []
    for seed in range(5):
        T = off(TRUTH, 20.0, 0.1, seed)
        dark = frame(T, number=seed)
        dark = dark.model_copy(update={"depth_m": np.full_like(dark.depth_m, np.nan)})
        registration = TRACKER.track(dark, off(T, 1.0, 0.01, seed))
        assert (registration.source, registration.belief.reason) == (Source.PMD_AMPLITUDE, "")
        errors.append(error(registration, T))
    assert_within(tuple(np.median(errors, axis=0)), 0.4, 0.01)


def test_the_brightness_of_a_target_with_little_depth_is_told_by_its_amplitude() -> None:
    whole = JointFrame.of(FRAME, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=JointConfig().tuning)
    row, column = np.mgrid[:287, :352]
    few = np.where((row % 40 < 4) & (column % 40 < 4), FRAME.depth_m, np.float32(np.nan))
    dim = (FRAME.amplitude // 20 + 1).astype(np.uint16)  # the sky is 1
    seen = FRAME.model_copy(update={"depth_m": few, "amplitude": dim})
    found = JointFrame.of(seen, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=JointConfig().tuning)
    assert isinstance(whole, JointFrame)
    assert isinstance(found, JointFrame)
    assert 0 < len(found.points_m) < JointConfig().tuning.acceptance.min_points
    assert found.typical == found.patch.typical == pytest.approx(whole.patch.typical / 20.0 + 1.0, rel=0.1)


def test_changes_half_a_pixel_from_an_edge_are_left_out_in_the_last_steps() -> None:
    tuning = JointConfig().tuning
    seen = JointFrame.of(FRAME, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=tuning)
    assert isinstance(seen, JointFrame)
    pose, edges = PoseArrays.of(TRUTH), EdgeModel.of(MOCKUP, spacing_m=0.02).arrays
    renderer = PatchRenderer(MOCKUP, tuning.edges)
    shown = renderer.render(seen.rays, seen.per_px, pose, seen.patch).shown
    sight = EdgeSight(edges, seen.lens, seen.patch, expect_edges(edges, seen.lens, seen.patch, shown))
    aside = pose._replace(t=pose.t + np.array((0.5 * pose.t[2] / seen.lens.fx, 0.0, 0.0)))
    errors = EdgeErrors(tuning.edges.sigma_px, 300.0, 3.0)
    first, last = (
        add_edge_points(no_sums(), sight, aside, 3.0, errors._replace(scale=scale))
        for scale in (SCALE, LAST_SCALE)
    )
    assert last.found == first.found > 100
    assert last.inliers < 0.8 * first.inliers


def test_first_steps_by_some_samples_of_edges_lead_to_the_same_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    turn = Rotation.from_rotvec((0.0, 0.01, 0.01))
    start = RigidTransform.from_components(TRUTH.translation, TRUTH.rotation * turn)
    whole = TRACKER.track(FRAME, start)
    monkeypatch.setattr(expected_edges, "MOST_AT_FIRST", 100)
    seen = JointFrame.of(FRAME, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=JointConfig().tuning)
    assert isinstance(seen, JointFrame)
    sights, pose = TRACKER._sights(seen), PoseArrays.of(TRUTH)
    every, some = sights.at(pose), sights.some_at(pose)
    assert len(every.expected.sample) / some.every < len(some.expected.sample) <= 150
    far = replace(seen, away_m=60.0)
    one, other = (
        TRACKER._problem(far, sight, TRACKER._near, TRACKER._edge_errors) for sight in (every, some)
    )
    assert other.edge_errors.independent == pytest.approx(some.every * one.edge_errors.independent)
    found = TRACKER.track(FRAME, start)
    assert found.T_sensor_target is not None
    assert whole.T_sensor_target is not None
    poses = (PoseArrays.of(each.T_sensor_target) for each in (whole, found))
    assert 0.0 < seen.moved_px(*poses, MOCKUP.radius_m) < 0.1
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(whole.covariance), rtol=0.05)


def test_a_small_displacement_of_an_edge_counts_in_the_last_steps_alone() -> None:
    seen = JointFrame.of(FRAME, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=JointConfig().tuning)
    assert isinstance(seen, JointFrame)
    pose = PoseArrays.of(TRUTH)
    sight = TRACKER._sights(seen).at(pose)
    first = TRACKER._problem(seen, sight, TRACKER._near[-1:], TRACKER._edge_errors)
    last = near_the_pose(first, first.planes)
    differ = []
    for problem in (first, last):
        squares = []
        for off_px in (0.0, 0.6 * ALIASED_PX):
            places = np.full(len(sight.expected.sample), off_px)
            moved = sight._replace(expected=sight.expected._replace(place=places))
            squares.append(add_edge_points(no_sums(), moved, pose, 3.0, problem.edge_errors).squares_px2)
        differ.append(squares[0] != squares[1])
    assert differ == [False, True]


def test_samples_of_edges_count_as_independent_where_they_are_farther_apart_than_the_blur() -> None:
    apart_px = correlation_px(JointConfig().tuning.edges.blur_px)
    shares = []
    for independent in (1.0, 0.5):
        errors = EdgeErrors(0.3, 300.0, 3.0, independent=independent)
        shifts = EdgeSums(no_sums(), 0.0, 0.0, no_sums(), no_sums(), 0.0)
        edges = EdgeEvidence(100 * 0.3**2, 100, 100, 100, 100.0, np.zeros(3), 0, 0.0, shifts)
        depth = DepthErrors(noise_m=0.006, most_points=400.0, bias_m=0.04, uneven_m=0.0, slack_m=0.0)
        problem = SimpleNamespace(depth_errors=depth, edge_errors=errors)
        shares.append(_shares.py_func(problem, FieldEvidence(0.0, 0.0, 0, 0.0), edges, 3.0).edges)
    assert shares[1] == pytest.approx(0.5 * shares[0])
    assert 2.0 < apart_px < 3.0


@pytest.mark.parametrize("dark", [False, True])
def test_depth_goes_on_alone_without_an_amplitude(*, dark: bool) -> None:
    amplitude = np.zeros_like(FRAME.amplitude) if dark else None
    blind = FRAME.model_copy(update={"amplitude": amplitude})
    registration = TRACKER.track(blind, off(TRUTH, 1.0, 0.01))
    assert_within(error(registration), 1.5, 0.02)
    assert (registration.source, registration.belief.reason) == (Source.PMD_DEPTH, "")


def test_a_frame_without_amplitude_compiles_no_kernel_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a loaded machine an amplitude may come too late; compiling for another type then costs the track."""
    types = []

    def recorded(
        images: DepthImages, rays_z: FloatArray, pixels: CoarsePixels, steepest: float
    ) -> CoarseRanges:
        types.append(typeof(images))
        return coarse_ranges(images, rays_z, pixels, steepest)

    monkeypatch.setattr("rpod_pose.pmd.joint.frame.coarse_ranges", recorded)
    warm, _ = ideal_frames(MOCKUP, TRUTH, None)
    for seen in (warm, warm.model_copy(update={"amplitude": None})):
        JointFrame.of(seen, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=JointConfig().tuning)
    assert types[0] == types[1]


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_the_unit_of_the_amplitude_does_not_matter(dtype: type) -> None:
    assert FRAME.amplitude is not None
    scaled = np.minimum(FRAME.amplitude * (255.0 / FRAME.amplitude.max()), 255.0).astype(dtype)
    registration = TRACKER.track(FRAME.model_copy(update={"amplitude": scaled}), off(TRUTH, 1.0, 0.01))
    assert_within(error(registration), 0.3, 0.006)


@pytest.mark.parametrize(("scale", "bias_m"), [(1.0, 0.03), (1.01, 0.0)], ids=["offset", "scale"])
def test_an_error_of_all_ranges_is_told_from_the_edges(scale: float, bias_m: float) -> None:
    near = make_pose(rotation=TRUTH.rotation, translation_m=(0.0, 0.0, 2.2))
    seen = frame(near)
    long = seen.model_copy(update={"depth_m": np.float32(scale) * seen.depth_m + np.float32(bias_m)})
    assert error(TRACKER.track(long, off(near, 1.0, 0.01)), near)[1] < 0.01


def test_a_glint_over_two_fifths_of_both_images_costs_little() -> None:
    assert FRAME.amplitude is not None
    columns = np.nonzero(np.isfinite(FRAME.depth_m))[1]
    wiped = np.zeros(FRAME.depth_m.shape, bool)
    wiped[:, : int(np.quantile(columns, 0.4))] = True
    glint = FRAME.model_copy(
        update={
            "depth_m": np.where(wiped, np.float32(np.nan), FRAME.depth_m),
            "amplitude": np.where(wiped, np.uint16(60000), FRAME.amplitude),
        }
    )
    registration = TRACKER.track(glint, off(TRUTH, 1.0, 0.01))
    assert not registration.belief.reason
    assert_within(error(registration), 1.0, 0.015)


def saturated(share: float) -> PmdFrame:
    """Return the frame with an amplitude clipped for a share of the lit pixels, as a reader hands it over."""
    lit = FRAME.amplitude[FRAME.depth_m > 0.0]  # type: ignore[index]
    gain = 65535.0 / np.quantile(lit, 1.0 - share)
    amplitude = np.minimum(FRAME.amplitude * gain, 65535.0).astype(np.uint16)
    clipped = amplitude == 65535
    depth_m = np.where(clipped, np.float32(np.nan), FRAME.depth_m)
    return FRAME.model_copy(update={"amplitude": amplitude, "saturated": clipped, "depth_m": depth_m})


@pytest.mark.parametrize(("share", "most"), [(0.1, 1.5), (0.6, 3.0)])
def test_saturated_pixels_cost_what_the_edges_beside_them_told(share: float, most: float) -> None:
    """Before, the other edges lost their weight too: with a tenth of the pixels, by more than half."""
    clean = TRACKER.track(FRAME, off(TRUTH, 0.5, 0.01))
    registration = TRACKER.track(saturated(share), off(TRUTH, 0.5, 0.01))
    assert registration.continues_track
    assert_within(error(registration), 0.25, 0.006)
    known, less = (np.trace(each.covariance[3:, 3:]) for each in (clean, registration))
    assert 1.0 < less / known < most


def test_where_all_is_saturated_there_is_no_pose() -> None:
    registration = TRACKER.track(saturated(0.999), off(TRUTH, 0.5, 0.01))
    assert not registration.continues_track
    assert "saturated" in registration.belief.reason


def test_a_lens_that_distorts_is_undone() -> None:
    camera = CAMERA.camera.model_copy(update={"distortion": np.array((-0.2, 0.1, 0.003, -0.002, 0.0))})
    config = CAMERA.model_copy(update={"camera": camera})
    assert_within(error(TRACKER.track(frame(config=config), off(TRUTH, 1.0, 0.01))), 0.3, 0.006)


@pytest.mark.parametrize("name", strange_frames())
def test_a_strange_frame_has_a_reason(name: str) -> None:
    assert TRACKER.track(strange_frames()[name], TRUTH).belief.reason


def _focal_length_off(shown: PmdFrame) -> PmdFrame:
    camera = shown.camera.model_copy(update={"fx": 1.15 * shown.camera.fx, "fy": 1.15 * shown.camera.fy})
    return shown.model_copy(update={"camera": camera})


def _of_another_target(_: PmdFrame) -> PmdFrame:
    return frame(target=HEXAGON)


def _upside_down(shown: PmdFrame) -> PmdFrame:
    assert shown.amplitude is not None
    turned = {"depth_m": shown.depth_m[::-1].copy(), "amplitude": shown.amplitude[::-1].copy()}
    return shown.model_copy(update=turned)


@pytest.mark.parametrize("spoil", [_focal_length_off, _of_another_target, _upside_down])
def test_what_is_not_the_target_as_this_camera_sees_it_is_refused(
    spoil: Callable[[PmdFrame], PmdFrame],
) -> None:
    assert "inconsistent" in TRACKER.track(spoil(FRAME), TRUTH).belief.reason


@pytest.mark.parametrize("material", ["silver-mli", "panel"])
def test_a_right_pose_is_believed_with_the_sun_behind_the_camera_from_afar(material: str) -> None:
    index = [known.name for known in MOCKUP.materials].index(material)
    coated = replace(MOCKUP, triangle_material=np.full_like(MOCKUP.triangle_material, index))
    emulator = PmdEmulator(CAMERA, coated, seed=3)
    for seed in range(4):
        T = off(make_pose(rotation=FACING, translation_m=(0.0, 0.0, 6.4)), 15.0, 0.1, seed)
        exposure = emulator.expose([T] * 4, sun_W_m2=np.array((0.0, 0.0, -1361.0)), frame=seed)
        seen = frame_of(exposure.depth_m, amplitude=exposure.amplitude)
        registration = TRACKER.track(seen, off(T, 1.0, 0.01, seed))
        assert not registration.belief.reason
        assert_within(error(registration, T), 3.0, 0.08)


def test_from_a_good_prediction_the_covariance_is_as_large_as_the_errors() -> None:
    """The mock-ups have parts that are 1 mm off, as the covariance assumes; the camera is calibrated."""
    pixel = CAMERA.pixel.model_copy(update={"wiggling_share": CALIBRATED_WIGGLING})
    left = CAMERA.model_copy(update={"pixel": pixel})
    tracker = JointTracker(JointConfig(), MOCKUP, calibrated=True)
    nees = []
    for number in range(24):
        T = off(TRUTH, 15.0, 0.1, 100 + number)
        body = built(MOCKUP, World(cad_error_m=0.001), np.random.default_rng(number))
        seen = frame(T, number=number, config=left, target=body)
        registration = tracker.track(seen, off(T, 0.3, 0.003, number))
        nees.append(nees_of(registration, T))
    least, most = chi2.ppf((0.005, 0.995), 6 * len(nees)) / len(nees)  # of the mean of independent ones
    assert least < np.mean(nees) < most


def test_brightness_that_varies_within_glossy_surfaces_does_not_turn_the_pose() -> None:
    """Sides that are a few pixels thin show some degrees beside the frontal view."""
    turned_deg = ((0.0, 5.0, 0.0), (0.0, -5.0, 0.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0))
    off_deg = []
    for turn_deg in turned_deg:
        turn = Rotation.from_rotvec(turn_deg, degrees=True)
        T = make_pose(rotation=turn * FACING, translation_m=(0.0, 0.0, 4.0))
        off_deg.append(error(TRACKER.track(frame(T), T), T)[0])
    assert np.mean(off_deg) < 0.08, off_deg


def test_what_the_view_does_not_show_is_uncertain() -> None:
    close = make_pose(rotation=FACING, translation_m=(0.0, 0.0, 1.15))
    roll = TRACKER.track(frame(close), close).covariance[5, 5]
    assert roll > 2.0 * TRACKER.track(FRAME, TRUTH).covariance[5, 5]


def test_what_a_face_that_fills_the_image_does_not_show_is_uncertain_in_the_parts_of_the_errors_too() -> None:
    """A filter that carries lasting errors takes the parts, not their sum."""
    close = make_pose(rotation=FACING, translation_m=(0.0, 0.0, HEXAGON.radius_m + 0.1))
    found = JointTracker(JointConfig(), HEXAGON).track(ideal_frames(HEXAGON, close, ())[0], close)
    parts = found.parts
    assert parts is not None
    together = parts.white + parts.of_sensor + parts.of_image + parts.of_model
    for part, unknown in ((slice(0, 3), 0.5 * HEXAGON.radius_m), (slice(3, 6), np.radians(50.0))):
        stated, told = (
            np.sqrt(np.linalg.eigvalsh(each[part, part])[-1]) for each in (found.covariance, together)
        )
        assert stated > unknown
        assert told == pytest.approx(stated, rel=0.1)


@pytest.mark.parametrize("lens", [(), (-0.28, 0.1, 0.001, -0.001, 0.0), (0.4, 0.1, 0, 0, 0, 0.6, 0.2, 0.02)])
@pytest.mark.parametrize("place_m", [(0.0, 0.0, 6.0), (2.9, 2.2, 6.0), (-5.0, 0.0, 10.0), (3.0, -0.5, 3.2)])
def test_the_pixels_around_a_target_hold_all_that_it_fills(
    lens: tuple[float, ...], place_m: tuple[float, float, float]
) -> None:
    camera = Camera(width=640, height=480, fx=400.0, fy=401.0, cx=322.0, cy=237.0, distortion=np.array(lens))
    met = cast(RayGrid.pinhole(camera), MOCKUP.triangles_m, make_pose(translation_m=place_m)).triangle >= 0
    window = _around(camera, np.array(place_m), MOCKUP.radius_m)
    assert np.count_nonzero(met[window]) == np.count_nonzero(met) > 0


def test_a_target_whose_origin_is_beside_the_camera_moves_as_what_is_seen_of_it() -> None:
    seen = JointFrame.of(FRAME, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=JointConfig().tuning)
    assert isinstance(seen, JointFrame)
    beside, shifted = (PoseArrays(np.eye(3), np.array((x, 0.0, -0.5))) for x in (2.0, 2.003))
    far = replace(seen, away_m=3.0)
    assert far.moved_px(beside, shifted, MOCKUP.radius_m) == pytest.approx(0.001 * CAMERA.camera.fx)


def test_a_pose_outside_the_patch_is_not_likely() -> None:
    seen = JointFrame.of(FRAME, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=JointConfig().tuning)
    assert isinstance(seen, JointFrame)
    right, beside, outside = (
        TRACKER._renderer.misfit(seen.rays, seen.per_px, PoseArrays.of(pose), seen.patch)
        for pose in (
            TRUTH,
            *(make_pose(rotation=TRUTH.rotation, translation_m=(x, 0, 3.5)) for x in (0.4, 9)),
        )
    )
    assert right < 0.2 * beside
    assert outside > 2.0 * right


def test_what_contradicts_a_pose_is_told_though_another_start_gave_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    contradicts = replace(TRACKER.track(_of_another_target(FRAME), TRUTH))
    told = iter([Registration.none(Source.PMD_JOINT, "no pose"), *[contradicts] * 9])
    monkeypatch.setattr(JointTracker, "_registered", lambda *_: next(told))
    monkeypatch.setattr(JointTracker, "_moved_along_sight", lambda *_: None)
    assert TRACKER.track(FRAME, off(TRUTH, 4.0, 0.05)).T_sensor_target is not None


def before_a_wall(turned: int, wall: float, phase_rad: float) -> tuple[PmdFrame, RigidTransform]:
    """Return a frame of the hexagonal body before a wall without ranges, and the pose."""
    camera = Camera(width=176, height=144, fx=190.0, fy=190.0, cx=87.5, cy=71.5)
    fine = Camera(width=528, height=432, fx=570.0, fy=570.0, cx=263.5, cy=215.5)
    attitude = Rotation.from_euler("ZYX", (8.0 + 40.0 * turned, -12.0 + 20.0 * turned, 25.0), degrees=True)
    truth = make_pose(rotation=FACING * attitude, translation_m=(0.1, -0.05, 3.5))
    rays, random = RayGrid.pinhole(fine), np.random.default_rng(turned)
    hits = cast(rays, HEXAGON.triangles_m, truth)
    seen, normals = np.isfinite(hits.range_m), HEXAGON.normals[np.maximum(hits.triangle, 0)]
    cosine = np.abs((normals * (rays.directions @ truth.rotation.as_matrix())).sum(axis=-1))

    def binned(image: np.ndarray) -> np.ndarray:
        return image.reshape(camera.height, 3, camera.width, 3).mean(axis=(1, 3))

    phasors = binned(np.where(seen, 100.0 * cosine, wall * np.exp(1j * phase_rad)))
    coarse = RayGrid.pinhole(camera)
    depth_m = cast(coarse, HEXAGON.triangles_m, truth).range_m * coarse.components[2]
    depth_m = np.where(binned(seen) > 0.9, depth_m + random.normal(0.0, 0.004, depth_m.shape), np.nan)
    amplitude = np.abs(phasors) + np.abs(random.normal(0.0, 0.7, depth_m.shape))
    return frame_of(depth_m, amplitude=amplitude.astype(np.float32), camera=camera), truth


@pytest.mark.parametrize(("turned", "wall", "phase_rad"), [(1, 40.0, 2.5), (2, 40.0, 3.14), (2, 70.0, 2.5)])
def test_a_bright_wall_without_ranges_moves_no_pose_by_more_than_is_stated(
    turned: int, wall: float, phase_rad: float
) -> None:
    """A pixel at the outline adds phasors of target and wall. The NEES was 101 to 348."""
    seen, truth = before_a_wall(turned, wall, phase_rad)
    found = JointTracker(JointConfig(), HEXAGON).track(seen, off(truth, 1.0, 0.03))
    assert found.belief.continues_track
    assert found.source is Source.PMD_JOINT
    assert nees_of(found, truth) < 20.0


def test_before_a_wall_as_bright_as_the_target_the_depth_alone_measures_the_pose() -> None:
    """Each pixel of the wall contradicts every pose, where the amplitude counts."""
    seen, truth = before_a_wall(1, 200.0, 2.5)
    found = JointTracker(JointConfig(), HEXAGON).track(seen, off(truth, 1.0, 0.03))
    assert found.belief.continues_track
    assert found.source is Source.PMD_DEPTH
    assert AMPLITUDE_LEFT_OUT in found.belief.evidence
    assert not found.begins_track
    assert "leave the amplitude out" in found.belief.refusal
    assert nees_of(found, truth) < 20.0
    elsewhere = JointTracker(JointConfig(), HEXAGON).track(seen, off(truth, 60.0, 0.03))
    assert not elsewhere.belief.continues_track


@pytest.mark.parametrize(("off_m", "level"), [(0.0, BeliefLevel.ACCEPTED), (0.5, BeliefLevel.CONTRADICTED)])
def test_a_pose_by_the_edges_alone_is_contradicted_by_the_median_of_noisy_ranges(off_m, level):
    noise_m = 0.5 * np.random.default_rng(2).standard_normal(FRAME.depth_m.shape)
    noisy = FRAME.model_copy(update={"depth_m": (FRAME.depth_m + noise_m + off_m).astype(np.float32)})
    found = TRACKER.track(noisy, TRUTH)
    assert found.source is Source.PMD_AMPLITUDE
    assert found.belief.level is level
    assert ("noisy ones too" in found.belief.reason) == (level is BeliefLevel.CONTRADICTED)


def test_a_smaller_body_before_something_bright_without_ranges_is_not_tracked_by_depth() -> None:
    """Bright pixels on the target's surface have no range, as far as the depth shows a part of it only."""
    seen, truth = before_a_wall(1, 200.0, 2.5)
    rows, _ = np.nonzero(seen.depth_m > 0.0)
    depth_m = seen.depth_m.copy()
    depth_m[: int(np.percentile(rows, 30.0))] = np.nan
    found = JointTracker(JointConfig(), HEXAGON).track(seen.model_copy(update={"depth_m": depth_m}), truth)
    assert found.belief.level is BeliefLevel.CONTRADICTED
    assert "bright pixels on the target's surface have no range" in found.belief.reason
