"""A navigator whose methods say what the test tells them to."""

import pickle
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.acceptance import accepted_by_residuals
from rpod_pose.lidar.deskew import deskewed
from rpod_pose.measurement import Measurement, Tick
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.filter.prediction import constant_twist
from rpod_pose.navigation.filter.state import Motion
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.ports import Acquisition, Candidate, Candidates, Methods, Registration
from rpod_pose.search.verified_search import VerifiedSearch
from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.estimator import EstimatorSettings, LidarInput, NavigatorConfig, PmdInput
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan, Mode, Source
from rpod_target import NO_SYMMETRY

SECOND_NS = 1_000_000_000
START_S = 100.0
MOUNT = make_pose(rotation=Rotation.from_rotvec([0.0, np.pi / 2, 0.0]), translation_m=[0.1, 0.2, 0.3])
LIMITS = AcceptanceConfig(max_cost_m2=0.01, min_explained_share=0.7)
BAD = "12 pixels with depth, 60 needed"


def truth(time_s: float) -> RigidTransform:
    """Return T_chaser_target: an approach of a slowly turning target."""
    since_s = time_s - START_S
    return make_pose(
        rotation=Rotation.from_rotvec([0.02 * since_s, 0.0, 0.0]),
        translation_m=[0.0, 0.0, 7.0 - 0.1 * since_s],
    )


def registration(
    T_sensor_target: RigidTransform, limits: AcceptanceConfig = LIMITS, **changes: object
) -> Registration:
    good = Registration(
        Source.PMD_DEPTH,
        T_sensor_target=T_sensor_target,
        cost_m2=0.001,
        inliers=500,
        inlier_share=0.9,
        explained_share=0.9,
        covariance=np.diag([1e-4] * 3 + [1e-5] * 3),
    )
    return accepted_by_residuals(replace(good, **changes), limits)


def failed() -> Registration:
    return Registration.none(Source.PMD_DEPTH, BAD)


@dataclass(frozen=True)
class View:
    """What a sensor sees at a time, as the methods are to take it."""

    stamp_ns: int
    tracked: Registration
    acquired: tuple[Registration, ...] = ()
    nearby: tuple[Registration, ...] = ()
    lasting_s: float = 0.0


@dataclass
class Method:
    """Acquisition and tracker in one. A candidate stands for the registration that it is refined to."""

    asked: list[str] = field(default_factory=list)
    _refined: dict[int, Registration] = field(default_factory=dict)

    def search(self, view: View) -> Candidates:
        self.asked.append("acquire")
        return self._candidates(view.acquired)

    def near(self, view: View, _: RigidTransform) -> Candidates:
        self.asked.append("near")
        return self._candidates(view.nearby)

    def track(self, view: View, T_sensor_target: RigidTransform) -> Registration:
        refined = self._refined.pop(id(T_sensor_target), None)
        self.asked.append("track" if refined is None else "refine")
        return view.tracked if refined is None else refined

    def _candidates(self, registrations: tuple[Registration, ...]) -> Candidates:
        candidates = [Candidate(make_pose(), 0.0) for _ in registrations]
        self._refined = {
            id(candidate.T_sensor_target): refined
            for candidate, refined in zip(candidates, registrations, strict=True)
        }
        self._kept = candidates  # so that no id is used twice
        return Candidates(tuple(candidates))


@dataclass
class Judge:
    """An acquirer that says what the test tells it to."""

    found: Acquisition

    def acquire(self, _: View) -> Acquisition:
        return self.found

    def near(self, *_: object) -> Acquisition:
        return self.found


@dataclass
class Rig:
    """A navigator, its state, and the method behind its one sensor."""

    navigator: Navigator
    method: Method
    state: object

    def see(self, view: View):
        measurement = Measurement("pmd", view, MOUNT)
        before = pickle.dumps(self.state)
        self.method.asked.clear()
        state, output = self.navigator.step(self.state, measurement)
        assert pickle.dumps(self.state) == before, "a step leaves the state that it is given alone"
        self.state = state
        return output

    def tick(self, time_s: float):
        self.state, output = self.navigator.step(self.state, Tick(round(time_s * SECOND_NS)))
        return output

    @property
    def mode(self) -> Mode:
        return self.state.mode


def scans_deskewed(data, T_sensor_target: RigidTransform, **twist):
    return deskewed(data, T_sensor_target, **twist) if isinstance(data, LidarScan) else data


def rig(
    *,
    pose=None,
    filter_config: FilterConfig | None = None,
    choice="first",
    found=None,
    alike=NO_SYMMETRY,
    alert=None,
    range_m=None,
    **limits,
) -> Rig:
    """Return a rig whose acquirer searches and refines, or finds what it is told."""
    settings = EstimatorSettings(
        sensors=(PmdInput(range_m=range_m, **({} if alert is None else {"alert_limit": alert})),),
        navigator=NavigatorConfig(**limits),
        filter=filter_config or FilterConfig(),
    )
    method = Method()
    acquirer = VerifiedSearch(method, method, choice) if found is None else Judge(found)
    methods = Methods(acquirer, method, scans_deskewed)
    navigator = Navigator(settings, {"pmd": methods}, centre_of_mass_m=np.zeros(3), alike=alike)
    return Rig(navigator, method, navigator.start(pose))


def turned(time_s: float, angle_deg: float) -> View:
    """Return a believed view of the target turned by an angle from its steady motion."""
    pose = in_sensor(time_s)
    turn = Rotation.from_rotvec([0.0, np.deg2rad(angle_deg), 0.0])
    seen = registration(make_pose(rotation=turn * pose.rotation, translation_m=pose.translation))
    return View(round(time_s * SECOND_NS), tracked=seen)


def in_sensor(time_s: float) -> RigidTransform:
    return MOUNT.inv() * truth(time_s)


def good(time_s: float, **changes: object) -> View:
    """Return a view in which every method finds the target."""
    seen = registration(in_sensor(time_s), **changes)
    return View(round(time_s * SECOND_NS), tracked=seen, acquired=(seen,), nearby=())


def blind(time_s: float) -> View:
    return View(round(time_s * SECOND_NS), tracked=failed())


def untracked(time_s: float) -> View:
    """Return a view in which only a search over everything finds the target."""
    return replace(good(time_s), tracked=failed())


def wrong(time_s: float, offset_m: float = 2.0) -> View:
    """Return a view whose registration looks good and lies elsewhere."""
    pose = in_sensor(time_s)
    moved_m = pose.translation + np.array([0.0, offset_m, 0.0])
    moved = make_pose(rotation=pose.rotation, translation_m=moved_m)
    return View(round(time_s * SECOND_NS), tracked=registration(moved))


def tracking(until_s: float = START_S + 1.0, rate_hz: float = 10.0, **limits: float) -> Rig:
    """Return a rig that tracks since ``START_S``; its last frame is at ``until_s``."""
    made = rig(**limits)
    for number in range(round((until_s - START_S) * rate_hz) + 1):
        made.see(good(START_S + number / rate_hz))
    assert made.mode == Mode.TRACKING
    return made


def lost(**limits: float) -> Rig:
    """Return a rig that has fallen silent at ``START_S + 1`` and is lost since 5 s later."""
    made = tracking(**limits)
    assert made.tick(START_S + 6.0) is not None
    return made


class Desk:
    """A navigator with a LIDAR and a camera."""

    def __init__(self, *, range_m=None, mount_sigma_deg: float = 0.0, **limits: float) -> None:
        self.settings = settings = EstimatorSettings(
            sensors=(LidarInput(), PmdInput(range_m=range_m)),
            navigator=NavigatorConfig(**limits),
            filter=FilterConfig(mount_sigma_deg=mount_sigma_deg, mount_sigma_m=0.1 * mount_sigma_deg),
        )
        self.asked: dict[str, Method] = {"lidar": Method(), "pmd": Method()}
        methods = {
            name: Methods(VerifiedSearch(method, method, "first"), method, lambda data, *_, **__: data)
            for name, method in self.asked.items()
        }
        self.navigator = Navigator(settings, methods, centre_of_mass_m=np.zeros(3))
        self.state = self.navigator.start()

    def see(self, sensor: str, view: View):
        self.asked[sensor].asked.clear()
        self.state, output = self.navigator.step(self.state, Measurement(sensor, view, MOUNT))
        return output

    def tick(self, time_s: float):
        self.state, output = self.navigator.step(self.state, Tick(round(time_s * SECOND_NS)))
        return output


def tracking_by_lidar(until_s: int = 3, **limits: float) -> Desk:
    """Return a desk that tracks by its LIDAR from ``START_S`` on, 3 s if nothing else is said."""
    desk = Desk(**limits)
    for number in range(until_s + 1):
        desk.see("lidar", good(START_S + number))
    assert desk.state.mode == Mode.TRACKING
    return desk


class Slow:
    """A model of motion that takes the longer, the farther it predicts: it is not asked for long steps."""

    states_noise = False, False

    def __init__(self, longest_s: float) -> None:
        self.longest_s = longest_s

    def __call__(self, state: FilterState, step_s: float, config: FilterConfig) -> Motion:
        assert step_s <= self.longest_s
        return constant_twist(state, step_s, config)
