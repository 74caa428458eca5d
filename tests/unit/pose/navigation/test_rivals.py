"""Rivals of an ambiguous first pose: how they are tracked, excluded and believed."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.belief import NOISE_M, Belief, Rival, contradicted
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.ports import Acquisition, Deskew, Methods, Registration
from rpod_schemas.config.estimator import EstimatorSettings, PmdInput
from rpod_schemas.poses import make_pose
from rpod_schemas.types import BeliefLevel, Mode, Source
from rpod_target import NO_SYMMETRY, Equivalence, Symmetry

SECOND_NS = 1_000_000_000
RIGHT = make_pose(translation_m=[0.0, 0.0, 6.0])
COVARIANCE = np.diag([1e-4] * 3 + [1e-5] * 3)
NEEDED = 0.95


def turned(angle_deg: float) -> RigidTransform:
    return RIGHT * RigidTransform.from_rotation(Rotation.from_euler("z", angle_deg, degrees=True))


def angle_deg(pose: RigidTransform) -> float:
    return float(np.degrees((RIGHT.rotation.inv() * pose.rotation).magnitude()))


@dataclass(frozen=True)
class View:
    """A frame: its log likelihood under a pose falls with the angle from the right one."""

    stamp_ns: int
    per_turn: float = 0.0
    contradicts: tuple[float, ...] = ()
    lasting_s: float = 0.0


@dataclass
class Scene:
    """Search, tracker and likelihood of a sensor, as the test tells them, and a navigator behind them."""

    angles_deg: tuple[float, ...] = (180.0,)
    searches: int = 0
    state: object = None
    alike: Equivalence = NO_SYMMETRY
    deskew: Deskew | None = None
    navigator: Navigator = field(init=False)

    def __post_init__(self) -> None:
        self.navigator = Navigator(
            EstimatorSettings(sensors=(PmdInput(),)),
            {"pmd": Methods(self, self, self.deskew, self.likelihoods)},
            centre_of_mass_m=np.zeros(3),
            alike=self.alike,
        )
        self.state = self.navigator.start()

    def acquire(self, _: View) -> Acquisition:
        self.searches += 1
        rivals = tuple(Rival(f"turned by {angle:g} deg", turned(angle), -0.1) for angle in self.angles_deg)
        level = BeliefLevel.DOUBTFUL if rivals else BeliefLevel.ACCEPTED
        reason = "several poses explain the measurement" if rivals else ""
        belief = Belief(level, reason, rivals=rivals, needed_weight=NEEDED)
        return Acquisition(Registration(Source.PMD_JOINT, RIGHT, belief, covariance=COVARIANCE))

    def near(self, view: View, _: RigidTransform) -> Acquisition:
        return self.acquire(view)

    def track(self, view: View, predicted: RigidTransform) -> Registration:
        refused = any(abs(angle_deg(predicted) - angle) < 1.0 for angle in view.contradicts)
        belief = contradicted("another frame's") if refused else Belief()
        return Registration(Source.PMD_JOINT, predicted, belief, covariance=COVARIANCE)

    def likelihoods(self, view: View, found: list[Registration]) -> np.ndarray:
        return -view.per_turn * np.array([angle_deg(each.T_sensor_target) for each in found]) / 180.0

    def see(self, time_s: float, **shown: object):
        view = View(round(time_s * SECOND_NS), **shown)
        self.state, output = self.navigator.step(self.state, Measurement("pmd", view, make_pose()))
        return output


def test_rivals_are_tracked_in_parallel_until_one_remains_and_the_operator_is_told():
    scene = Scene((180.0, 90.0))
    first = scene.see(1.0)
    assert (first.status.mode, first.status.accepted, scene.searches) == (Mode.ACQUIRING, False, 1)
    modes, leads = [], []
    for second in range(2, 12):
        output = scene.see(float(second), per_turn=2.0)
        modes.append(output.status.mode)
        if Mode.TRACKING in modes:
            break
        assert output.odometry is None
        assert output.status.ambiguous
        assert "3 rivals are tracked in parallel, turned by 90, 180 deg" in output.status.reason
        assert output.status.evidence["rivals"] == 3.0
        leads.append(output.status.evidence["rivals_lead_log_likelihood"])
    # half of a frame's log likelihood counts, as in the filter: 0.5 a second between the best two
    np.testing.assert_allclose(leads, 0.1 + 0.5 * np.arange(1, len(leads) + 1))
    assert modes[-1] is Mode.TRACKING
    assert len(modes) == 6
    assert scene.searches == 2  # none between the first frame and the one that decides
    assert angle_deg(output.odometry.pose) == pytest.approx(0.0, abs=1e-6)


def test_at_a_high_rate_frames_count_no_more_than_one_a_second():
    scene = Scene()
    scene.see(1.0)
    for frame in range(1, 16):
        output = scene.see(1.0 + frame / 15.0, per_turn=1.0)
    assert output.status.evidence["rivals_lead_log_likelihood"] == pytest.approx(0.1 + 1.0)


def test_a_rival_that_a_frame_contradicts_is_excluded_and_if_it_contradicts_all_the_search_begins_anew():
    scene = Scene()
    scene.see(1.0)
    assert "2 rivals" in scene.see(2.0).status.reason
    scene.see(3.0, contradicts=(0.0, 180.0))
    assert scene.searches == 2
    assert scene.see(4.0, contradicts=(180.0,)).status.mode is Mode.ACQUIRING  # the search still names both
    scene.angles_deg = ()
    assert scene.see(5.0, contradicts=(180.0,)).status.mode is Mode.TRACKING


def test_the_last_rival_is_not_believed_where_a_new_search_finds_another_pose():
    scene = Scene()
    scene.see(1.0)
    scene.angles_deg = (120.0,)
    output = scene.see(2.0, per_turn=20.0)
    assert output.odometry is None
    assert {round(angle_deg(each.pose)) for each in output.status.hypotheses} == {0, 120, 180}
    best, new, *_ = output.status.hypotheses
    assert (best.weight, new.log_likelihood) == pytest.approx((1.0 / (1.0 + np.exp(-0.1)), -0.1), abs=1e-3)


def test_too_many_rivals_and_exact_twins_are_not_tracked_in_parallel():
    many, twins = (
        Scene(tuple(np.arange(20.0, 340.0, 20.0))),
        Scene((180.0,), alike=Equivalence.of([Symmetry((0.0, 0.0, 1.0), 2, exact=True)])),
    )
    for scene in (many, twins):
        for second in range(1, 4):
            scene.see(float(second))
        assert scene.searches == 3


def test_rivals_that_nothing_tells_apart_are_given_up_for_a_new_search():
    scene = Scene()
    for second in range(1, 18):
        assert scene.see(float(second)).status.mode is Mode.ACQUIRING
    assert scene.searches == 2


def test_frames_of_rivals_count_less_the_nearer_they_are():
    """Errors of near frames are alike: a rival's covariance is that of the track that it may become."""
    scene = Scene()
    for number in range(9):
        scene.see(100.0 + number / 45.0)
    steps = scene.state.rivals.tracks[0].history.steps
    assert len(steps) == 8
    assert [step.measurement.since_s for step in steps[1:]] == pytest.approx([1 / 45] * 7, rel=1e-6)


def test_rivals_whose_registrations_show_other_noise_are_compared_under_the_same(monkeypatch):
    def shown(predicted):
        evidence = {NOISE_M: 0.04} if angle_deg(predicted) < 90.0 else {}
        return Registration(Source.LIDAR, predicted, Belief(evidence=evidence), covariance=COVARIANCE)

    def likelihoods(_, found):
        return np.array([5000.0 * each.belief.evidence.get(NOISE_M, 0.0) for each in found])

    monkeypatch.setattr(Scene, "track", lambda _, __, predicted: shown(predicted))
    monkeypatch.setattr(Scene, "likelihoods", staticmethod(likelihoods))
    scene = Scene(deskew=lambda view, *_, **__: view)
    scene.see(1.0)
    output = scene.see(2.0)
    assert output.status.evidence["rivals_lead_log_likelihood"] == pytest.approx(0.1)
