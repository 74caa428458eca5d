"""The target among walls and arms, and behind a plate: found, tracked, and refused where it is not."""

import weakref
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_campaign.engine.trial.surroundings import surroundings
from rpod_pose.belief import Belief
from rpod_pose.methods import methods_of
from rpod_pose.pmd.other_things import PmdFrames
from rpod_pose.ports import Acquisition, Methods, Registration
from rpod_pose.surroundings import tracker as tracker_module
from rpod_pose.surroundings.known import Background, KnownParts, KnownSurroundingsError, known_parts
from rpod_pose.surroundings.other_unit import other_units
from rpod_pose.surroundings.separation import Label, RangeImage
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.surroundings import CylinderThing, SensorSurroundings
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import BeliefLevel, Camera, PmdFrame, Source
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

CAMERA = PmdConfig()
POSE = make_pose(rotation=Rotation.from_euler("ZYX", [20, 60, 10], degrees=True), translation_m=(0.1, 0, 4))


@cache
def frame(name: str, shown: bool = True) -> PmdFrame:
    things = surroundings(name, load_target("mockup"), (4.0, 4.0))
    return seen(things, POSE if shown else make_pose(translation_m=(0.0, 0.0, -9.0)))


def seen(things, pose) -> PmdFrame:
    exposure = PmdEmulator(CAMERA, load_target("mockup"), seed=2, surroundings=things).expose(
        [pose] * 4, sun_W_m2=np.zeros(3), frame=1
    )
    for image in (exposure.depth_m, exposure.amplitude):
        image.setflags(write=False)
    return PmdFrame(
        stamp_ns=0,
        frame_id="",
        depth_m=exposure.depth_m,
        amplitude=exposure.amplitude,
        camera=CAMERA.camera,
        info=CAMERA.info(),
    )


@cache
def methods() -> Methods:
    return methods_of(PmdInput(), load_target("mockup"))


def assert_near(found) -> None:
    attitude_rad, position_m = pose_error(POSE, found)
    assert np.rad2deg(np.linalg.norm(attitude_rad)) < 0.5
    assert np.linalg.norm(position_m) < 0.03


def near(angle_deg: float, shift_m: float):
    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * np.array([0.6, 0.0, 0.8]))
    return make_pose(
        rotation=turn * POSE.rotation, translation_m=POSE.translation + np.array([shift_m, 0, 0])
    )


def test_the_target_is_found_in_a_laboratory_that_fills_the_image():
    in_laboratory = frame("laboratory")
    assert np.isfinite(in_laboratory.depth_m).mean() > 0.95
    assert np.isfinite(frame("none").depth_m).mean() < 0.3
    found = methods().acquirer.acquire(in_laboratory)
    assert found.begins_track, found.belief.refusal
    assert_near(found.pose)


@pytest.mark.parametrize("name", ["laboratory", "occluded"])
def test_the_target_is_tracked_among_things_and_behind_a_plate(name):
    tracked = methods().tracker.track(frame(name), near(2.0, 0.03))
    assert tracked.continues_track, tracked.belief.reason
    assert_near(tracked.T_sensor_target)
    assert (tracked.belief.evidence["visible_share"] < 0.8) == (name == "occluded")


ARM = CylinderThing(
    kind="cylinder",
    radius_m=0.1,
    length_m=1.7,
    fixed_to="target",
    pose=make_pose(
        rotation=Rotation.from_euler("ZYX", [-125, -44.5, 0], degrees=True), translation_m=(0.6, 1.3, -1.5)
    ),
)
"""An arm that holds the mock-up from the side."""
AHEAD = make_pose(translation_m=(0.0, 0.0, 4.0))


def test_the_target_is_found_and_tracked_where_an_unknown_arm_is_all_else_that_is_seen():
    with_arm = seen((ARM,), AHEAD)
    acquirer, tracker = methods().acquirer._acquirer, methods().tracker._tracker
    assert tracker.cluttered(with_arm) is None  # the arm is within the target's size
    assert not acquirer._acquirer.acquire(with_arm).begins_track  # as if it showed the target alone
    assert not tracker._tracker.track(with_arm, AHEAD).continues_track
    found = acquirer.acquire(with_arm)
    assert found.begins_track, found.belief.refusal
    tracked = tracker.track(with_arm, make_pose(translation_m=(0.03, 0.0, 4.0)))
    assert tracked.continues_track, tracked.belief.reason
    for pose in (found.pose, tracked.T_sensor_target):
        attitude_rad, position_m = pose_error(AHEAD, pose)
        assert np.rad2deg(np.linalg.norm(attitude_rad)) < 0.5
        assert np.linalg.norm(position_m) < 0.03


def test_a_stub_within_the_targets_reach_is_no_other_thing_and_its_remedy_is_told(monkeypatch):
    """A wrong pose leaves a part of the target itself, which looks like such a stub."""
    acquirer, tracker = methods().acquirer._acquirer, methods().tracker._tracker
    with_arm = seen((ARM,), AHEAD)
    monkeypatch.setattr(RangeImage, "rays_beyond", lambda *_: 0)
    found = acquirer.acquire(with_arm)
    assert not found.begins_track
    assert "if something touches the target, declare it" in found.belief.refusal
    assert not tracker.track(with_arm, AHEAD).continues_track


def test_a_frame_that_is_doubtful_and_contradicts_no_pose_is_not_searched_for_an_arm(monkeypatch):
    """An arm contradicts the target alone; a search among other things takes many times as long."""
    acquirer = methods().acquirer._acquirer
    doubtful = Acquisition(Registration.none(Source.NONE, "only half of the edges are in their place"))
    monkeypatch.setattr(acquirer, "_in_frame", lambda *_: doubtful)
    monkeypatch.setattr(acquirer, "_found", lambda *_: pytest.fail("searched among other things"))
    assert acquirer.acquire(seen((ARM,), AHEAD)) is doubtful


def test_an_arm_without_the_target_is_neither_found_nor_tracked():
    arm = ARM.model_copy(update={"fixed_to": "chaser", "pose": AHEAD * ARM.pose})
    alone = seen((arm,), make_pose(translation_m=(0.0, 0.0, -9.0)))
    assert np.isfinite(alone.depth_m).sum() > 500
    assert not methods().acquirer.acquire(alone).begins_track
    assert not methods().tracker.track(alone, AHEAD).continues_track


CLOSE = make_pose(rotation=Rotation.from_euler("ZYX", [-90, 90, 0], degrees=True), translation_m=(0, 0.05, 2))
"""The mock-up's nozzle before the camera, so close that the camera has no range in the nozzle."""


@pytest.mark.parametrize("far_m", [6.0, 7.0])
def test_a_pose_that_no_range_shows_is_not_tracked_in_a_hole_of_the_target_itself(far_m):
    """As after a long search: the target has come near since, and the prediction is far behind it."""
    close = seen((), CLOSE)
    middle = np.isfinite(close.depth_m[130:150, 165:185])
    assert not middle.any(), "the target has a hole without ranges"
    far = make_pose(rotation=CLOSE.rotation, translation_m=(0.0, 0.05, far_m))
    tracker = methods().tracker._tracker
    for tracked in (tracker.track(close, far), tracker.track_among(close, far)):
        assert not tracked.continues_track
    assert tracker.track(close, CLOSE).continues_track


def test_where_a_pose_explains_a_small_part_of_a_frame_the_rest_is_no_arm():
    with_arm = seen((ARM,), AHEAD)
    tracker = methods().tracker._tracker
    tracked = tracker.track(with_arm, AHEAD)
    assert tracked.continues_track
    assert tracked.belief.evidence["measured_share"] > 0.5
    belief = replace(tracked.belief, evidence={**tracked.belief.evidence, "measured_share": 0.3})
    assert tracker.is_touched(with_arm, tracked)
    assert not tracker.is_touched(with_arm, replace(tracked, belief=belief))


def test_nothing_is_found_and_nothing_tracked_in_a_laboratory_without_the_target():
    empty = frame("laboratory", shown=False)
    assert not methods().acquirer.acquire(empty).begins_track
    assert not methods().tracker.track(empty, POSE).continues_track


@cache
def times(name: str, ratio: float) -> PmdFrame:
    """Return a frame whose depths are in another unit."""
    depth_m = (frame(name).depth_m * np.float32(ratio)).astype(np.float32)
    depth_m.setflags(write=False)
    return frame(name).model_copy(update={"depth_m": depth_m})


@pytest.mark.parametrize(
    ("name", "ratio", "told"),
    [("none", 4.0, 4.0), ("none", 10.0, 10.0), ("none", 1.0, 0.0), ("laboratory", 1.0, 0.0)],
)
def test_a_part_of_what_is_the_target_in_another_unit_is_not_the_target(name, ratio, told):
    """A pose at a part of the thing; in a laboratory the target is held by an arm."""
    acquirer, frames = methods().acquirer._acquirer, PmdFrames()
    seen = times(name, ratio)
    pose = make_pose(rotation=POSE.rotation, translation_m=ratio * POSE.translation)
    accepted = Acquisition(Registration(Source.PMD_JOINT, T_sensor_target=pose))
    assert acquirer._ratio_of_units(seen, frames.image(seen, fine=False), accepted) == told


def test_a_room_that_fills_the_view_is_the_target_in_no_unit():
    """Nothing shows how large it is, and divided by ten it lies within the error of the ranges."""
    image, radius_m = PmdFrames().image(frame("laboratory"), fine=False), load_target("mockup").radius_m
    assert not list(other_units(image, radius_m, POSE.translation))
    alone = PmdFrames().image(times("none", 10.0), fine=False)
    assert 10.0 in [each.ratio for each in other_units(alone, radius_m, 10.0 * POSE.translation)]


def test_a_first_pose_that_is_a_part_of_a_larger_thing_names_the_unit(monkeypatch):
    accepted = Acquisition(Registration(Source.PMD_JOINT, T_sensor_target=POSE, belief=Belief()))
    acquirer = methods().acquirer._acquirer
    monkeypatch.setattr(acquirer, "_searched", lambda *_: accepted)
    monkeypatch.setattr(acquirer, "_searched_in_remainder", lambda *_: accepted)
    assert acquirer.acquire(frame("laboratory")).begins_track
    monkeypatch.setattr(acquirer, "_ratio_of_units", lambda *_: 4.0)
    found = acquirer.acquire(frame("laboratory"))
    assert not found.begins_track
    assert "if all depths are divided by 4: check the unit" in found.belief.refusal


def test_a_first_pose_that_the_tracker_loses_in_the_same_frame_is_not_accepted(monkeypatch):
    beside = make_pose(rotation=POSE.rotation, translation_m=POSE.translation - np.array([0.8, 0, 0]))
    accepted = Acquisition(Registration(Source.PMD_JOINT, T_sensor_target=beside, belief=Belief()))
    acquirer = methods().acquirer._acquirer
    monkeypatch.setattr(acquirer, "_searched", lambda *_: accepted)
    monkeypatch.setattr(acquirer, "_searched_in_remainder", lambda *_: accepted)
    found = acquirer.acquire(frame("laboratory"))
    assert not found.begins_track
    assert found.belief.level is BeliefLevel.CONTRADICTED
    assert found.belief.reason


def test_a_ray_that_passes_where_the_target_should_be_contradicts_the_pose():
    beside = make_pose(rotation=POSE.rotation, translation_m=POSE.translation - np.array([0.9, 0, 0]))
    assert not methods().tracker.track(frame("laboratory"), beside).continues_track


class Counting:
    """A tracker that counts the alignments of another one."""

    def __init__(self, tracker) -> None:
        self.tracker, self.alignments = tracker, 0

    def track(self, measurement, pose):
        self.alignments += 1
        return self.tracker.track(measurement, pose)


def test_where_the_frame_contradicts_every_pose_within_a_margin_none_is_aligned(monkeypatch):
    among, seen = methods().acquirer._acquirer._tracker, frame("laboratory")
    counting = Counting(among._tracker)
    monkeypatch.setattr(among, "_tracker", counting)
    found = among.track(seen, near(2.0, 0.03))
    assert found.continues_track, found.belief.reason
    assert counting.alignments == 2  # at the widest margin and at the next one
    beside = make_pose(rotation=POSE.rotation, translation_m=POSE.translation - np.array([0.8, 0, 0]))
    refused = among.track(seen, beside)
    assert not refused.continues_track
    assert counting.alignments == 3  # none at a narrow margin
    whole = PmdFrames().part_of(seen.model_copy(), seen)
    assert among.track(whole, beside).belief.level is BeliefLevel.CONTRADICTED
    assert counting.alignments == 3


@pytest.mark.parametrize("covered", [0.0, 0.2, 0.5, 0.8])
def test_a_pixel_at_the_outline_keeps_the_light_of_the_part_that_the_target_covers(covered):
    """Ranges of a camera that does not mix them are those of the wall; others lie between both."""
    target, wall, column = (4.0, 200.0), (6.5, 120.0), 30
    share = covered * target[1] / (covered * target[1] + (1.0 - covered) * wall[1])
    range_m = np.full((40, 60), wall[0], np.float32)
    amplitude = np.full((40, 60), wall[1], np.float32)
    range_m[:, :column], amplitude[:, :column] = target
    range_m[:, column] = share * target[0] + (1.0 - share) * wall[0]
    amplitude[:, column] = covered * target[1] + (1.0 - covered) * wall[1]
    camera = Camera(width=60, height=40, fx=60.0, fy=60.0, cx=29.5, cy=19.5)
    seen = PmdFrame(stamp_ns=0, frame_id="", depth_m=range_m, amplitude=amplitude, camera=camera)
    labels = np.where(np.arange(60) < column, Label.KEPT, Label.BEYOND) * np.ones((40, 1))
    left = PmdFrames().separated(seen, labels.astype(np.uint8), np.zeros((40, 60), bool)).amplitude
    np.testing.assert_allclose(left[:, :column], target[1])
    np.testing.assert_allclose(left[2:-2, column], covered * target[1], atol=1.1)
    np.testing.assert_allclose(left[:, column + 1 :], target[1] / 1024.0)  # one count of floats


def known(**changes: object) -> KnownParts:
    background = Background.learned([PmdFrames().every_range_m(frame("laboratory", shown=False))])
    return KnownParts(**({"frames": PmdFrames(), "gate_m": (0, np.inf), "unused": None,
                          "background": background} | changes))  # fmt: skip


def test_a_learned_background_is_taken_out_of_the_frame():
    left = np.isfinite(known().without(frame("laboratory")).depth_m)
    alone = np.isfinite(frame("none").depth_m)
    assert left[alone].mean() > 0.95
    assert left[~alone].mean() < 0.1


def test_what_is_outside_the_range_gate_or_masked_is_taken_out_of_the_frame():
    unused = np.zeros(frame("none").depth_m.shape, bool)
    unused[:100] = True
    kept = known(background=None, gate_m=(1.0, 5.5), unused=unused).without(frame("laboratory")).depth_m
    assert not np.isfinite(kept[:100]).any()
    assert np.nanmax(kept) <= 5.5
    assert np.isfinite(kept).any()


def test_a_background_is_learned_from_frames_spread_over_all_while_few_are_kept():
    alive, most = [], 0

    def ranges_m():
        nonlocal most
        for number in range(2000):
            range_m = np.full((2, 3), 1.0 + number, np.float32)
            alive[:] = [each for each in alive if each() is not None] + [weakref.ref(range_m)]
            most = max(most, len(alive))
            yield range_m

    background = Background.learned(ranges_m())
    assert background.frames == 2000
    assert background.range_m[0, 0] == pytest.approx(1000.0, abs=10.0)
    assert most < 250


@pytest.mark.parametrize(
    ("frames_m", "says"),
    [
        ([], "no frames: record the sensor without the target"),
        ([np.ones((2, 3)), np.ones((3, 3))], "frames of 3 x 2 and 3 x 3 pixels"),
    ],
)
def test_a_background_of_no_frames_or_of_different_ones_is_refused_with_what_to_do(frames_m, says):
    with pytest.raises(KnownSurroundingsError, match=says):
        Background.learned(frames_m)


@pytest.mark.parametrize("damage", ["cut", "one array", "other shapes"])
def test_a_file_that_is_no_background_is_refused_with_its_name_and_the_remedy(damage, tmp_path):
    file, ones = tmp_path / "b.npz", np.ones((10, 20), np.float32)
    np.savez_compressed(file, range_m=ones, sigma_m=ones[:5] if damage == "other shapes" else ones)
    if damage == "cut":
        file.write_bytes(file.read_bytes()[:100])
    if damage == "one array":
        with file.open("wb") as stream:
            np.save(stream, ones)
    with pytest.raises(
        KnownSurroundingsError, match=r"background .*b\.npz cannot be read.*calibrate background"
    ):
        Background.read(file)


def test_a_background_that_unpacks_to_gigabytes_or_is_damaged_inside_is_one_error(tmp_path):
    good, ones = tmp_path / "b.npz", np.ones((10, 20), np.float32)
    Background(ones, ones).write(good)
    data = bytearray(good.read_bytes())
    name, extra = (int.from_bytes(data[at : at + 2], "little") for at in (26, 28))
    data[30 + name + extra] = 0x07  # a kind of block that no compression has
    (tmp_path / "damaged.npz").write_bytes(data)
    data = bytearray(good.read_bytes())
    at = data.index(b"PK\x01\x02") + 24
    data[at : at + 4] = (2**31).to_bytes(4, "little")
    (tmp_path / "bomb.npz").write_bytes(data)
    with pytest.raises(KnownSurroundingsError, match=r"damaged\.npz cannot be read"):
        Background.read(tmp_path / "damaged.npz")
    with pytest.raises(
        KnownSurroundingsError, match=r"bomb\.npz cannot be read: it holds 2,147,48\d,\d+ bytes"
    ):
        Background.read(tmp_path / "bomb.npz")


def test_a_background_of_another_size_is_refused_with_both_sizes(tmp_path):
    Background(np.ones((10, 20), np.float32), np.ones((10, 20), np.float32)).write(tmp_path / "b.npz")
    parts = KnownParts.of(SensorSurroundings(background="b.npz"), PmdFrames(), tmp_path)
    with pytest.raises(KnownSurroundingsError, match="background has 20 x 10 pixels, the frame 352 x 287"):
        parts.without(frame("none"))
    (tmp_path / "known.yaml").write_text("sensors: {pmd: {background: none.npz}}")
    with pytest.raises(KnownSurroundingsError, match=r"background .*none\.npz cannot be read"):
        known_parts(tmp_path / "known.yaml", "pmd", PmdFrames())
    assert known_parts(tmp_path / "known.yaml", "lidar", PmdFrames()) is None


def test_poses_of_one_frame_share_its_ranges_and_a_pose_is_rendered_once_for_its_check_and_its_alignment(
    monkeypatch,
):
    class Nothing:
        def track(self, *_) -> Registration:
            return Registration.none(Source.NONE, "")

    calls, rendered = [], tracker_module.with_target_at
    monkeypatch.setattr(
        tracker_module, "with_target_at", lambda *given: calls.append("pose") or rendered(*given)
    )
    frames = PmdFrames()
    image = frames.image
    monkeypatch.setattr(
        frames, "image", lambda *given, **fine: calls.append("ranges") or image(*given, **fine)
    )
    tracker = tracker_module.TrackerAmongThings(Nothing(), frames, load_target("mockup"))
    whole = frame("laboratory")
    part = frames.part_of(whole, whole)
    for angle_deg in (0.0, 1.0):
        assert not tracker.track(part, near(angle_deg, 0.0)).belief.reason
    assert calls == ["ranges", "pose", "pose"]
