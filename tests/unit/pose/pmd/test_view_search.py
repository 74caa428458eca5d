from dataclasses import replace
from functools import cache
from itertools import pairwise

import cv2
import numpy as np
import pytest
from pmd_frames import depth_frame, frame_of, strange_frames
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid
from rpod_pose.belief import Belief, contradicted, doubtful
from rpod_pose.pmd import view_search
from rpod_pose.pmd.fit import PmdFit, PmdFitter
from rpod_pose.pmd.frame_search import FrameSearch, Pose
from rpod_pose.pmd.joint.tracker import JointTracker
from rpod_pose.pmd.scene import scene_of
from rpod_pose.pmd.view_search import ViewSearch, _Aligned, _Task
from rpod_pose.ports import Outcome, Registration
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.search.attitude_grid import even_directions
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.config.pmd.search import PmdAcquisitionConfig, PmdAcquisitionTuning
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import BeliefLevel, PmdFrame, Source
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target
from rpod_target.target import DistanceField

SUN_W_M2 = 1361.0 * np.array([0.4, -0.5, -0.768])
OBLIQUE = make_pose(
    rotation=Rotation.from_euler("yx", (30.0, 20.0), degrees=True) * FACING, translation_m=(0.1, -0.1, 4.5)
)
REAR = make_pose(
    rotation=Rotation.from_euler("y", 180.0, degrees=True) * FACING, translation_m=(0.0, 0.0, 4.0)
)
target = cache(load_target)
tracking = cache(lambda name: JointTracker(JointConfig(), target(name)))
searching = cache(lambda name: ViewSearch(PmdAcquisitionConfig(), target(name), tracking(name)))
camera = cache(lambda name: PmdEmulator(PmdConfig(), target(name), seed=3))


@cache
def seen(name: str, T: RigidTransform, frame: int = 0) -> PmdFrame:
    """Return a frame of a target in the sun."""
    exposure = camera(name).expose([T] * 4, sun_W_m2=SUN_W_M2, frame=frame)
    return frame_of(exposure.depth_m, amplitude=exposure.amplitude)


@cache
def found(name: str = "mockup", T: RigidTransform = OBLIQUE):
    return searching(name).acquire(seen(name, T))


def changed(frame: PmdFrame, **intrinsics: float) -> PmdFrame:
    return frame.model_copy(update={"camera": frame.camera.model_copy(update=intrinsics)})


def attitude_error_deg(T_truth, T):
    return np.rad2deg(np.linalg.norm(pose_error(T_truth, T)[0]))


def assert_right(T_truth, T):
    assert attitude_error_deg(T_truth, T) < 4.0
    assert np.linalg.norm(T.translation - T_truth.translation) < 0.08


@pytest.mark.parametrize("seed", range(4))
def test_any_attitude_is_found_without_a_guess(seed):
    T = make_pose(rotation=Rotation.random(random_state=seed), translation_m=(0.2, 0.1, 3.5 + 0.5 * seed))
    assert_right(T, searching("mockup").acquire(seen("mockup", T)).pose)


def test_what_explains_the_frame_is_accepted():
    assert found().outcome is Outcome.ACCEPTED
    assert found().begins_track
    assert found().hypotheses[0].weight > 0.95
    assert np.isfinite(found().covariance).all()
    assert found().belief.reason == ""


def test_an_accepted_pose_is_aligned_with_the_edges_too():
    result = found()
    assert result.registration.source is Source.PMD_JOINT
    assert attitude_error_deg(OBLIQUE, result.pose) < 0.5
    assert np.linalg.norm(result.pose.translation - OBLIQUE.translation) < 0.015
    assert np.array_equal(result.hypotheses[0].pose.as_matrix(), result.pose.as_matrix())


class Uncomparing:
    """A tracker to which all poses are equally likely."""

    def log_likelihoods(self, _, found, **__):
        return np.zeros(len(found))


def test_what_the_tracker_does_not_believe_is_refused():
    class Refusing(Uncomparing):
        def track(self, _, T_sensor_target):
            return Registration(Source.PMD_JOINT, T_sensor_target, contradicted("edges are elsewhere"))

    search = ViewSearch(PmdAcquisitionConfig(), target("mockup"), Refusing())
    result = search.acquire(seen("mockup", OBLIQUE))
    assert (result.outcome, result.belief.reason) == (Outcome.FAILED, "edges are elsewhere")
    assert result.pose is None


class HalfTheWay(Uncomparing):
    """A tracker whose every alignment leaves half of the pose's error.

    Args:
        beliefs: beliefs in the alignments; those after them are accepted.
        likelier: number of the alignments of which each is likelier than the one before.
    """

    def __init__(self, *beliefs: Belief, likelier: int) -> None:
        self._beliefs, self._likelier, self.poses = iter(beliefs), likelier, []

    def track(self, _, T_sensor_target):
        off_m = T_sensor_target.translation - OBLIQUE.translation
        T = make_pose(rotation=OBLIQUE.rotation, translation_m=OBLIQUE.translation + 0.5 * off_m)
        self.poses.append(T)
        belief = next(self._beliefs, Belief())
        return Registration(Source.PMD_JOINT, T, belief, covariance=1e-6 * np.eye(6))

    def log_likelihoods(self, _, found, **__):
        numbers = [index for each in found for index, T in enumerate(self.poses) if T is each.T_sensor_target]
        return np.array([number if number < self._likelier else -number for number in numbers], float)


def settled(*beliefs: Belief, likelier: int = 100) -> tuple[RigidTransform | None, list[RigidTransform]]:
    """Return the pose of a search, and those of the alignments of its first pose alone."""
    tracker, alone = HalfTheWay(*beliefs, likelier=likelier), PmdAcquisitionTuning(rival_losses=1.0)
    search = ViewSearch(PmdAcquisitionConfig(tuning=alone), target("mockup"), tracker)
    return search.acquire(seen("mockup", OBLIQUE)).pose, tracker.poses


def test_a_first_pose_is_aligned_again_until_it_settles():
    pose, aligned = settled()
    tuning = PmdAcquisitionConfig().tuning
    px_per_m = PmdConfig().camera.fx / OBLIQUE.translation[2]
    moves_px = [px_per_m * np.linalg.norm((b * a.inv()).translation) for a, b in pairwise(aligned)]
    assert pose is aligned[-1]
    assert 2 <= len(aligned) <= 1 + tuning.settling
    assert moves_px[-1] < tuning.settled_px or len(aligned) == 1 + tuning.settling
    assert all(move >= tuning.settled_px for move in moves_px[:-1])


@pytest.mark.parametrize("likelier", [1, 2])
def test_an_alignment_at_which_the_frame_is_no_likelier_ends_them_and_is_not_used(likelier):
    pose, aligned = settled(likelier=likelier)
    assert len(aligned) == likelier + 1
    assert pose is aligned[likelier - 1]


@pytest.mark.parametrize("belief", [contradicted, doubtful])
def test_an_alignment_that_is_believed_less_than_the_one_before_is_not_used(belief):
    pose, aligned = settled(Belief(), belief("edges are elsewhere"))
    assert pose is aligned[0]


def test_an_alignment_may_be_believed_more_than_the_one_before():
    pose, aligned = settled(doubtful("few edges are in their place"), Belief())
    assert pose is aligned[-1]


def longer(frame: PmdFrame, bias_m: float) -> PmdFrame:
    """Return a frame whose ranges are longer by a length."""
    along = RayGrid.pinhole(frame.camera).components[2]
    return frame_of(frame.depth_m + bias_m * along, amplitude=frame.amplitude, camera=frame.camera)


@pytest.mark.parametrize(("range_m", "bias_m"), [(1.8, 0.065), (1.8, -0.065), (1.8, 0.0), (6.0, 0.065)])
def test_the_outline_tells_the_bias_of_the_ranges_where_it_moves_the_outline(range_m, bias_m):
    search, T = searching("mockup"), make_pose(rotation=OBLIQUE.rotation, translation_m=(0.0, 0.0, range_m))
    frame, t = longer(seen("mockup", T), bias_m), T.translation * (1.0 + bias_m / range_m)
    scene = scene_of(frame, search._tuning.scene, radius_m=target("mockup").radius_m)
    fitter = PmdFitter(search._tuning.model, search._model.shown, scene)
    R = T.rotation.as_matrix()
    found_m = search._bias_m(
        _Task(frame, scene, np.empty((0, 3, 3), np.float32), None), fitter, Pose(R, t, fitter.fit(R, t)), 0.1
    )
    camera = frame.camera
    step_m = scene.view.stride * range_m**2 / camera.fx / target("mockup").radius_m
    assert found_m == pytest.approx(bias_m if range_m < 6.0 else 0.0, abs=0.75 * step_m)
    assert found_m != 0.0 or range_m == 6.0 or bias_m == 0.0


class FromTheBias(Uncomparing):
    """A tracker that accepts poses at a distance alone, and leaves each pose as it is."""

    def __init__(self, accepted_m: float) -> None:
        self._accepted_m = accepted_m

    def track(self, _, T_sensor_target):
        near = abs(np.linalg.norm(T_sensor_target.translation) - self._accepted_m) < 0.01
        belief = Belief() if near else contradicted("edges are elsewhere")
        return Registration(Source.PMD_JOINT, T_sensor_target, belief, covariance=1e-6 * np.eye(6))


@pytest.mark.parametrize("accepted_m", [4.0, 3.95])
def test_a_pose_is_aligned_where_the_outline_shows_it_and_else_where_the_depth_does(accepted_m):
    search = ViewSearch(PmdAcquisitionConfig(), target("mockup"), FromTheBias(accepted_m))
    frame, R = seen("mockup", OBLIQUE), OBLIQUE.rotation.as_matrix()
    pose = Pose(R, np.array((0.0, 0.0, 4.0)), PmdFit(100.0, pixels=1000))
    task = _Task(frame, None, np.empty((0, 3, 3), np.float32), None)
    result = search._registered(task, pose, 0.05)
    assert result.belief.level is BeliefLevel.ACCEPTED
    assert result.T_sensor_target.translation[2] == pytest.approx(accepted_m)


class Judging(Uncomparing):
    """A tracker that aligns to a given pose, or not at all, and refuses attitudes near another."""

    def __init__(self, *, to: RigidTransform | None = None, refuses: RigidTransform | None = None) -> None:
        self._to, self._refuses = to, refuses

    def track(self, _, T_sensor_target):
        T = T_sensor_target if self._to is None else self._to
        refused = self._refuses is not None and attitude_error_deg(self._refuses, T) < 10.0
        belief = contradicted("edges are elsewhere") if refused else Belief()
        return Registration(Source.PMD_JOINT, T, belief, covariance=1e-6 * np.eye(6))


class Oblique(Judging):
    """A judging tracker to which a pose is the likelier, the nearer its attitude is to the true one."""

    def log_likelihoods(self, _, found, **__):
        return -np.array([attitude_error_deg(OBLIQUE, each.T_sensor_target) for each in found])


def rear_face() -> PmdFrame:
    depth_m = seen("mockup", REAR).depth_m
    return frame_of(np.where(depth_m < 3.4, depth_m, np.nan))


def test_rivals_that_the_alignment_leads_to_one_pose_are_that_pose():
    depth_m = depth_frame(target("mockup"), REAR).depth_m
    rear_face_alone = frame_of(np.where(depth_m < 3.4, depth_m, np.nan))  # without the camera's error
    search = ViewSearch(PmdAcquisitionConfig(), target("mockup"), Judging(to=REAR))
    result = search.acquire(rear_face_alone)
    assert (result.outcome, len(result.hypotheses)) == (Outcome.ACCEPTED, 1)


@pytest.mark.parametrize("tracker", [Oblique, Judging])
def test_no_pose_is_accepted_while_one_that_is_refused_explains_the_whole_frame_better(tracker):
    search = ViewSearch(PmdAcquisitionConfig(), target("mockup"), tracker(refuses=OBLIQUE))
    result = search.acquire(seen("mockup", OBLIQUE))
    why = "a refused pose explains the frame better than the accepted ones; refused as edges are elsewhere"
    assert (result.belief.reason == why) is (tracker is Oblique)
    assert (result.outcome is Outcome.FAILED) is (tracker is Oblique)


@pytest.mark.parametrize("tracker", [Oblique, Judging])
def test_an_alignment_that_leads_away_from_a_pose_that_explains_the_whole_frame_is_not_accepted(tracker):
    away = Rotation.from_rotvec((0.2, 0.0, 0.0)) * OBLIQUE.rotation
    to = make_pose(rotation=away, translation_m=OBLIQUE.translation)
    search = ViewSearch(PmdAcquisitionConfig(), target("mockup"), tracker(to=to))
    result = search.acquire(seen("mockup", OBLIQUE))
    assert (result.outcome is Outcome.FAILED) is (tracker is Oblique)
    assert ("leads away from a pose that explains the frame" in result.belief.reason) is (tracker is Oblique)


def aligned_pose(turn_deg: float, losses: tuple[float, float], belief: Belief | None = None) -> _Aligned:
    """Return a pose turned from the oblique one, with its losses before and after its alignment."""
    away = Rotation.from_rotvec((np.radians(turn_deg), 0.0, 0.0)) * OBLIQUE.rotation
    T = make_pose(rotation=away, translation_m=OBLIQUE.translation)
    registration = Registration(Source.PMD_JOINT, T, belief or Belief(), covariance=np.zeros((6, 6)))
    R, t = PoseArrays.of(T)
    return _Aligned(R, t, registration, np.array(losses), PoseArrays(R, t))


def test_of_alignments_beside_each_other_one_that_explains_the_frame_clearly_better_is_taken():
    ended = [
        aligned_pose(0.0, (100.0, 160.0)),
        aligned_pose(90.0, (110.0, 200.0)),
        aligned_pose(2.0, (200.0, 150.0)),
    ]
    (best, other), logs = searching("mockup")._merged(ended, np.array([-160.0, -200.0, -150.0]))
    assert best.R is ended[2].R
    assert logs.tolist() == [0.0, -50.0]
    assert best.losses.tolist() == [100.0, 150.0]
    assert other.losses.tolist() == [110.0, 200.0]
    assert np.sqrt(best.registration.covariance[3, 3]) < np.radians(0.02)


def test_alignments_that_end_beside_each_other_and_explain_the_frame_alike_are_in_the_covariance():
    ended = [aligned_pose(0.0, (100.0, 150.0)), aligned_pose(2.0, (200.0, 149.0))]
    (best,), _ = searching("mockup")._merged(ended, np.array([-150.0, -149.0]))
    share = 1.0 / (1.0 + np.exp(-1.0))
    assert best.R is ended[0].R
    assert best.registration.covariance[3, 3] == pytest.approx(share * np.radians(2.0) ** 2, rel=1e-3)


@pytest.mark.parametrize(
    ("turn_deg", "gain", "tracker", "better"),
    [
        (2.0, 5.0, Judging, False),
        (2.0, 10.0, Judging, True),
        (90.0, 5.0, Judging, True),
        (90.0, 5.0, Oblique, False),
    ],
)
def test_a_refused_pose_must_be_better_than_noise_makes_it_and_by_the_whole_frame_too(
    turn_deg, gain, tracker, better
):
    best = aligned_pose(0.0, (100.0, 100.0))
    refused = aligned_pose(turn_deg, (100.0 - gain, 200.0), contradicted("it led away"))
    judge = tracker()
    if tracker is Judging:
        judge.log_likelihoods = lambda _, found, **__: np.arange(len(found))
    search = ViewSearch(PmdAcquisitionConfig(), target("mockup"), judge)
    found = search._better(seen("mockup", OBLIQUE), best, [best, refused], 1.0)
    assert found == ("it led away" if better else "")


class Alike:
    """A fitter to which all poses explain the coarse pixels alike."""

    def __init__(self, *_, **__) -> None:
        pass

    def fit(self, *_):
        return PmdFit(100.0, pixels=1000)


def test_rivals_and_near_symmetries_are_weighed_by_the_whole_frame(monkeypatch):
    turned = OBLIQUE * make_pose(rotation=Rotation.from_rotvec([0.0, 0.0, np.pi]))
    poses = [Pose(*PoseArrays.of(T), Alike().fit()) for T in (turned, OBLIQUE)]
    monkeypatch.setattr(view_search, "PmdFitter", Alike)
    monkeypatch.setattr(view_search.FrameSearch, "search", lambda *_: poses)
    tracker, frame = Judging(), seen("mockup", OBLIQUE)
    search = ViewSearch(PmdAcquisitionConfig(), target("mockup"), tracker)
    tracker.log_likelihoods = Oblique().log_likelihoods
    result = search.acquire(frame)
    assert result.outcome is Outcome.ACCEPTED
    assert attitude_error_deg(result.pose, OBLIQUE) < 1.0
    tracker.log_likelihoods = Judging().log_likelihoods
    result = search.acquire(frame)
    assert result.outcome is Outcome.AMBIGUOUS
    for turn in target("mockup").turns():
        assert any(attitude_error_deg(turned * turn, rival.pose) < 1.0 for rival in result.hypotheses)


def test_a_frame_without_amplitude_does():
    T = make_pose(rotation=OBLIQUE.rotation, translation_m=(0.0, 0.1, 3.5))
    result = searching("mockup").acquire(depth_frame(target("mockup"), T, noise_m=0.01))
    assert_right(T, result.pose)


def test_a_frame_without_amplitude_is_searched_once(monkeypatch):
    """Materials matter for an amplitude alone; a search that failed was made again, the same."""
    searches = []
    monkeypatch.setattr(FrameSearch, "search", lambda *_: searches.append(1) or [])
    frame = depth_frame(target("mockup"), OBLIQUE)
    assert searching("mockup").near(frame, OBLIQUE).outcome is Outcome.FAILED
    assert len(searches) == 1
    lit = frame.model_copy(update={"amplitude": np.full(frame.depth_m.shape, 100, np.uint16)})
    assert searching("mockup").near(lit, OBLIQUE).outcome is Outcome.FAILED
    assert len(searches) == 3


def test_a_wide_start_ends_at_the_pose():
    for axis in np.eye(3):
        off = make_pose(rotation=Rotation.from_rotvec(np.deg2rad(25.0) * axis), translation_m=0.5 * axis)
        guess = RigidTransform.from_components(
            OBLIQUE.translation + off.translation, off.rotation * OBLIQUE.rotation
        )
        assert_right(OBLIQUE, searching("mockup").near(seen("mockup", OBLIQUE), guess).pose)


def test_near_a_guess_no_pose_far_from_it_is_considered():
    guess = OBLIQUE * make_pose(rotation=Rotation.from_rotvec([np.pi, 0.0, 0.0]))
    pose = searching("mockup").near(seen("mockup", OBLIQUE), guess).pose
    assert pose is None or attitude_error_deg(guess, pose) < 60.0


def test_a_bare_body_of_one_material_is_ambiguous_by_its_symmetry_alone():
    result = found("hexagonal-body")
    turns = [RigidTransform.identity(), *target("hexagonal-body").turns(exact=True)]
    assert result.outcome is Outcome.AMBIGUOUS
    assert all(rival.exact for rival in result.belief.rivals)
    assert result.begins_track
    assert "symmetry" in result.belief.reason
    assert sum(hypothesis.weight for hypothesis in result.hypotheses) == pytest.approx(1.0)
    for turn in turns:
        nearest = min(attitude_error_deg(OBLIQUE * turn, one.pose) for one in result.hypotheses)
        assert nearest < 4.0


def test_a_view_without_details_is_ambiguous():
    result = searching("mockup").acquire(rear_face())
    assert result.outcome is Outcome.AMBIGUOUS
    assert not result.begins_track
    assert len(result.hypotheses) > 1
    assert sum(hypothesis.weight for hypothesis in result.hypotheses) == pytest.approx(1.0)


def test_a_mirrored_frame_is_refused():
    frame = seen("mockup", OBLIQUE)
    mirrored = frame_of(frame.depth_m[:, ::-1], amplitude=frame.amplitude[:, ::-1])
    result = searching("mockup").acquire(mirrored)
    assert result.outcome is Outcome.FAILED
    assert "inconsistent" in result.belief.reason or "explain" in result.belief.reason


@pytest.mark.parametrize("material", ["panel", "nose", "silver-mli"])
def test_the_target_in_other_materials_is_found_by_its_shape(material):
    mockup = target("mockup")
    index = [known.name for known in mockup.materials].index(material)
    coated = replace(mockup, triangle_material=np.full_like(mockup.triangle_material, index))
    exposure = PmdEmulator(PmdConfig(), coated, seed=4).expose([OBLIQUE] * 4, sun_W_m2=SUN_W_M2, frame=0)
    result = searching("mockup").acquire(frame_of(exposure.depth_m, amplitude=exposure.amplitude))
    assert result.outcome is Outcome.ACCEPTED
    assert_right(OBLIQUE, result.pose)


def spotted(seed: int, *, share: float, size_px: int):
    """Return which pixels lie in squares that cover a share of the image."""
    shape = seen("mockup", OBLIQUE).depth_m.shape
    squares = np.random.default_rng(seed).random((30, 30)) < share
    row, column = (np.arange(size) // size_px % 30 for size in shape)
    return squares[np.ix_(row, column)]


@pytest.mark.parametrize("seed", range(3))
def test_depth_that_is_lost_in_patches_is_missed_little(seed):
    frame = seen("mockup", OBLIQUE)
    lost = spotted(seed, share=0.4, size_px=25)
    result = searching("mockup").acquire(
        frame_of(np.where(lost, np.nan, frame.depth_m), amplitude=frame.amplitude)
    )
    assert result.outcome is Outcome.ACCEPTED
    assert_right(OBLIQUE, result.pose)


@pytest.mark.parametrize("seed", range(3))
def test_glints_that_wipe_out_both_images_contradict_nothing(seed):
    frame = seen("mockup", OBLIQUE)
    near = cv2.dilate(np.isfinite(frame.depth_m).astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    wiped = spotted(seed, share=0.4, size_px=15) & near
    result = searching("mockup").acquire(
        frame_of(
            np.where(wiped, np.nan, frame.depth_m),
            amplitude=np.where(wiped, 0, frame.amplitude).astype(np.uint16),
        )
    )
    assert result.outcome is Outcome.ACCEPTED
    assert_right(OBLIQUE, result.pose)


@pytest.mark.parametrize("share", [0.5, 0.8, 1.2, 1.5])
def test_a_wrong_focal_length_is_refused(share):
    frame = seen("mockup", OBLIQUE)
    wrong = changed(frame, fx=share * frame.camera.fx, fy=share * frame.camera.fy)
    assert searching("mockup").acquire(wrong).outcome is Outcome.FAILED


@pytest.mark.parametrize("wrong", [{"cx": 100.0}, {"cy": 10.0}, {"fx": 500.0}, {"fy": 1000.0}])
def test_the_camera_matrix_of_another_image_is_named(wrong):
    result = searching("mockup").acquire(changed(seen("mockup", OBLIQUE), **wrong))
    assert result.outcome is Outcome.FAILED
    assert result.belief.reason.startswith("the camera matrix is another image's")


@pytest.mark.parametrize("name", ["envisat-slim", "rocket-stage"])
def test_another_target_is_refused(name):
    result = searching("mockup").acquire(seen(name, OBLIQUE))
    assert result.outcome is Outcome.FAILED
    assert result.belief.reason


@pytest.mark.parametrize("frame", strange_frames().values(), ids=strange_frames().keys())
def test_a_strange_frame_fails_with_a_reason(frame):
    for result in (searching("mockup").acquire(frame), searching("mockup").near(frame, OBLIQUE)):
        assert result.outcome is Outcome.FAILED
        assert result.belief.reason
        assert result.hypotheses == ()


def test_the_same_frame_gives_the_same_pose():
    again = searching("mockup").acquire(seen("mockup", OBLIQUE))
    assert np.array_equal(again.pose.as_matrix(), found().pose.as_matrix())


def test_directions_are_even():
    directions = even_directions(150)
    cosines = directions @ directions.T - 2.0 * np.eye(150)
    nearest_deg = np.rad2deg(np.arccos(cosines.max(axis=1)))
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert nearest_deg.min() > 10.0
    assert nearest_deg.max() < 20.0


@cache
def scaled(share: float):
    """Return the mock-up, scaled."""
    whole, field = target("mockup"), target("mockup").require_field()
    lengths = ("triangles_m", "edges_m", "model_points_m", "centre_of_mass_m", "radius_m")
    return replace(
        whole,
        digest=f"{whole.digest}-{share:g}",
        field=DistanceField(
            share * field.origin_m, share * field.spacing_m, np.float32(share) * field.values
        ),
        **{name: share * getattr(whole, name) for name in lengths},
    )


@pytest.mark.parametrize("share", [0.1, 3.0])
def test_a_body_of_another_size_is_judged_alike_as_far_away_as_its_size(share):
    """The ranges' noise is scaled, so that no length is left but those of the camera."""

    def placed(T):
        return make_pose(rotation=T.rotation, translation_m=share * T.translation)

    frame, tracker = seen("mockup", OBLIQUE), JointTracker(JointConfig(), scaled(share))
    depth_m = (np.float32(share) * frame.depth_m).astype(np.float32)
    depth_m.setflags(write=False)
    there = frame.model_copy(update={"depth_m": depth_m})
    begin = make_pose(rotation=Rotation.from_rotvec((0.02, 0.0, 0.01))) * OBLIQUE
    half = make_pose(
        rotation=OBLIQUE.rotation * Rotation.from_euler("y", 180.0, degrees=True),
        translation_m=OBLIQUE.translation,
    )
    for start, believed in ((begin, True), (half, False)):
        whole = tracking("mockup").track(frame, start)
        other = tracker.track(there, placed(start))
        assert whole.belief.level == other.belief.level
        assert (other.belief.level is BeliefLevel.ACCEPTED) is believed
    acquired = ViewSearch(PmdAcquisitionConfig(), scaled(share), tracker).acquire(there)
    assert acquired.outcome is found().outcome is Outcome.ACCEPTED
    assert_right(
        OBLIQUE, make_pose(rotation=acquired.pose.rotation, translation_m=acquired.pose.translation / share)
    )
