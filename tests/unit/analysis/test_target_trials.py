"""Methods tried on a target: which kinds, at which conditions, and what counts as right."""

import itertools
import time
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import yaml
from numba import njit
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.target_check.clocks import Clocks, Moment, clocks
from rpod_analysis.target_check.conditions import conditions
from rpod_analysis.target_check.emulated import EmulatedKind
from rpod_analysis.target_check.trials import try_methods
from rpod_pose.lidar.methods import LIDAR_METHODS
from rpod_pose.methods import methods_of
from rpod_pose.pmd.depth_preparation import DepthPreparation
from rpod_pose.ports import Methods, Registration, Task
from rpod_schemas import registry
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.sensors import Method, method, sensor_kind
from rpod_schemas.sensors.lidar import LIDAR
from rpod_schemas.types import Source
from rpod_target import Target, load_target
from rpod_target.target import Symmetry

PAINT = {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3}
DOCUMENT = {
    "name": "chip",
    "mass_kg": 10.0,
    "materials": {"paint": PAINT},
    "parts": [
        {"name": "body", "shape": "box", "size_m": [1.0, 0.7, 0.5], "material": "paint"},
        {
            "name": "wing",
            "shape": "box",
            "size_m": [0.6, 0.05, 0.4],
            "material": "paint",
            "T_target_part": {"translation_m": [0.7, 0.2, 0.1]},
        },
    ],
    "distance_field": {"spacing_m": 0.03, "margin_m": 0.3},
    "model_points": 300,
}


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Target:
    folder = tmp_path_factory.mktemp("chip")
    (folder / "chip.yaml").write_text(yaml.safe_dump(DOCUMENT))
    return load_target(folder / "chip.yaml", cache=folder / "cache")


class ProbeConfig(LidarConfig):
    kind: str = "probe"


class GuessConfig(MethodConfig):
    kind: str = "guess"


class GiveUpConfig(MethodConfig):
    kind: str = "give_up"


class ProbeInput(LidarInput):
    kind: str = "probe"
    acquisition: GiveUpConfig = GiveUpConfig()  # type: ignore[assignment]
    tracking: GuessConfig = GuessConfig()  # type: ignore[assignment]


class Guess:
    """Believes each prediction as it is."""

    def track(self, measurement: object, T_sensor_target: RigidTransform) -> Registration:  # noqa: ARG002
        return Registration(Source.OTHER, T_sensor_target)


def guess(_: GuessConfig, __: Task) -> Guess:
    return Guess()


def give_up(_: GiveUpConfig, __: Task) -> object:
    raise ValueError("needs a body with a nose")


def tracker(task: Task) -> Guess:
    made: Guess = method("probe", task.sensor.tracking.kind).built(task.sensor.tracking, task)
    return made


def make(task: Task) -> Methods:
    acquirer = method("probe", task.sensor.acquisition.kind).built(task.sensor.acquisition, task)
    return Methods(acquirer, tracker(task))


PROBE_METHODS = replace(LIDAR_METHODS, make=make, tracker=tracker)
PROBE = replace(
    LIDAR, name="probe", emulated=ProbeConfig, heard=ProbeInput, methods=f"{__name__}:PROBE_METHODS"
)
GUESS = Method("probe", "tracking", GuessConfig, f"{__name__}:guess")
GIVE_UP = Method("probe", "acquisition", GiveUpConfig, f"{__name__}:give_up")


@pytest.fixture
def only_a_probe(monkeypatch: pytest.MonkeyPatch):
    """A sensor kind of another package stands alone in the registry."""
    objects = {"probe": PROBE, "probe.guess": GUESS, "probe.give_up": GIVE_UP}
    entries = [
        EntryPoint(name, "elsewhere:X", "rpod.methods" if "." in name else "rpod.sensors") for name in objects
    ]
    for function in (registry._entries, registry.load, registry.resolve):
        function.cache_clear()
    real = registry.resolve_name
    own = {GUESS.build: guess, GIVE_UP.build: give_up, PROBE.methods: PROBE_METHODS}
    monkeypatch.setattr(registry, "resolve_name", lambda name: own.get(name) or real(name))
    monkeypatch.setattr(registry, "entry_points", lambda group: [e for e in entries if e.group == group])
    monkeypatch.setattr(EntryPoint, "load", lambda entry: objects[entry.name])
    yield
    for function in (registry._entries, registry.load, registry.resolve):
        function.cache_clear()


@pytest.mark.usefixtures("only_a_probe")
def test_the_kinds_and_methods_of_other_packages_are_tried(target: Target) -> None:
    found = {one.name: one for one in try_methods(target, trials=3)}
    assert set(found) == {"guess", "give_up"}
    assert all(one.default and one.sensor == "probe" for one in found.values())
    assert (found["guess"].total.frames, found["guess"].total.right, found["guess"].works) == (3, 3, True)
    assert found["guess"].total.attitude_deg == pytest.approx(3.0)
    assert (found["give_up"].total.frames, found["give_up"].works) == (0, False)
    assert found["give_up"].reason == "needs a body with a nose"


@pytest.mark.usefixtures("only_a_probe")
def test_a_method_that_believes_what_is_wrong_is_told_as_wrong(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    turned = RigidTransform.from_rotation(Rotation.from_rotvec([0.3, 0.0, 0.0]))
    track = Guess.track
    monkeypatch.setattr(Guess, "track", lambda self, frame, pose: track(self, frame, pose * turned))
    (found,) = (one for one in try_methods(target, trials=3) if one.name == "guess")
    assert (found.total.right, found.total.wrong, found.works) == (0, 3, False)
    assert found.total.wrong_coarse == 0  # no covariance is stated


@pytest.mark.usefixtures("only_a_probe")
@pytest.mark.parametrize(("sigma_deg", "coarse"), [(12.0, 3), (1.0, 0)])
def test_a_wrong_pose_that_is_no_farther_off_than_it_says_is_coarse(
    sigma_deg: float, coarse: int, target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    turned = RigidTransform.from_rotation(Rotation.from_rotvec([0.3, 0.0, 0.0]))
    covariance = np.diag([1e-2] * 3 + [np.radians(sigma_deg) ** 2] * 3)
    monkeypatch.setattr(
        Guess, "track", lambda _, __, pose: Registration(Source.OTHER, pose * turned, covariance=covariance)
    )
    (found,) = (one for one in try_methods(target, trials=3) if one.name == "guess")
    assert (found.total.wrong, found.total.wrong_coarse) == (3, coarse)


@pytest.mark.parametrize(
    ("kind", "least", "most"),
    [("lidar", (20, 90, 400), (45, 180, 700)), ("pmd", (0.1, 0.2, 0.45), (0.55, 0.55, 1.0))],
)
def test_frames_hold_as_much_of_the_target_as_their_condition_says(
    kind: str, least: tuple[float, ...], most: tuple[float, ...], target: Target
) -> None:
    emulated = EmulatedKind(sensor_kind(kind), target, seed=1)
    for number, each in enumerate(conditions(emulated, target, 6, seed=4)):
        frame = emulated.frame(each.T_sensor_target, sun_W_m2=each.sun_W_m2, number=number)
        assert frame is not None
        if frame.lens is None:
            seen = float(len(frame.returns_m))
        else:
            rows, columns = np.nonzero(np.isfinite(frame.images[0].values))
            seen = max(np.ptp(rows), np.ptp(columns)) / frame.lens.height
        assert least[number % 3] <= seen <= most[number % 3], each.name
        # a target that would be farther away than the camera measures is nearer, and fills more
        reach_m = getattr(emulated.sensor, "unambiguous_range_m", np.inf)
        assert np.linalg.norm(each.T_sensor_target.translation) < reach_m


def test_the_frames_of_a_check_are_the_same_each_time(target: Target) -> None:
    emulated = EmulatedKind(sensor_kind("lidar"), target, seed=1)
    first, second = (list(conditions(emulated, target, 3, seed=4)) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.T_sensor_target.as_matrix(), other.T_sensor_target.as_matrix())
        sun = one.sun_W_m2
        a, b = (emulated.frame(each.T_sensor_target, sun_W_m2=sun, number=1) for each in (one, other))
        assert a is not None
        assert b is not None
        np.testing.assert_array_equal(a.returns_m, b.returns_m)


def test_an_exact_symmetry_is_no_error(target: Target) -> None:
    truth = make_pose(translation_m=[0.0, 0.0, 5.0])
    half = truth * RigidTransform.from_rotation(Rotation.from_rotvec([0.0, 0.0, np.pi]))
    assert target.equivalence.error_of(half, truth)[0] == pytest.approx(180.0)
    same = replace(target, symmetries=(Symmetry((0.0, 0.0, 1.0), 2, exact=True),))
    assert same.equivalence.error_of(half, truth)[0] == pytest.approx(0.0, abs=1e-6)


def test_a_camera_s_distances_are_unwrapped_before_its_methods(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared = []
    applied = DepthPreparation._applied
    monkeypatch.setattr(DepthPreparation, "_applied", lambda *args: prepared.append(args) or applied(*args))
    found = try_methods(target, trials=1, kinds=[sensor_kind("pmd")])
    assert len(prepared) >= sum(one.total.frames for one in found) > 2


@pytest.mark.usefixtures("only_a_probe")
def test_a_method_that_raises_is_told_as_one_that_refuses(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Guess, "track", lambda self, frame, pose: 1 // 0)  # noqa: ARG005
    (found,) = (one for one in try_methods(target, trials=3) if one.name == "guess")
    assert (found.total.refused, found.works) == (3, False)
    assert found.reason.startswith("raised ZeroDivisionError")


@pytest.mark.usefixtures("only_a_probe")
def test_a_slow_method_is_tried_once_at_least_and_not_much_longer_than_allowed(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    readings = (Moment(9.0 * count, 0.0) for count in itertools.count())
    monkeypatch.setattr(Clocks, "now", lambda _: next(readings))
    (found,) = (one for one in try_methods(target) if one.name == "guess")
    assert found.total.frames == 2  # before its third one more than 40 s have passed


SIGNS = (1, -1)
CUBE = [((1, 0, 0), 4), ((0, 1, 0), 4), ((0, 0, 1), 4)]
CUBE += [((1, y, z), 3) for y in SIGNS for z in SIGNS]
CUBE += [(axis, 2) for s in SIGNS for axis in ((0, 1, s), (1, 0, s), (1, s, 0))]
BODIES = {
    "cube": (
        {"shape": "box", "size_m": [1.0, 1.0, 1.0]},
        [{"axis": list(axis), "order": order, "exact": True} for axis, order in CUBE],
    ),
    "tank": (
        {"shape": "cylinder", "radius_m": 0.3, "length_m": 1.2},
        [
            {"axis": [1, 0, 0], "order": 12, "exact": True, "continuous": True},
            {"axis": [0, 1, 0], "order": 2, "exact": True},
        ],
    ),
}


@pytest.mark.parametrize("sensor", ["lidar", "pmd"])
@pytest.mark.parametrize("body", BODIES)
def test_a_body_whose_symmetries_are_all_declared_is_found(tmp_path: Path, body: str, sensor: str) -> None:
    shape, symmetries = BODIES[body]
    part = {"name": "body", "material": "paint", **shape}
    (tmp_path / "body.yaml").write_text(
        yaml.safe_dump(DOCUMENT | {"parts": [part], "symmetries": symmetries})
    )
    target = load_target(tmp_path / "body.yaml", cache=tmp_path)
    emulated = EmulatedKind(sensor_kind(sensor), target, seed=1)
    acquirer = methods_of(emulated.heard, target, emulated.setup).acquirer
    *_, near = conditions(emulated, target, 3, seed=4)
    frame = emulated.frame(near.T_sensor_target, sun_W_m2=near.sun_W_m2, number=1)
    found = acquirer.acquire(frame)
    assert found.begins_track
    assert target.equivalence.error_of(found.pose, near.T_sensor_target)[0] < 4.0
    assert len(found.hypotheses) == (24 if body == "cube" else 2)


def test_the_time_in_which_kernels_are_compiled_is_not_that_of_a_method() -> None:
    with clocks() as clock:
        before, begin_s = clock.now(), time.perf_counter()
        njit(lambda value: value + 1)(1)
        after, took_s = clock.now(), time.perf_counter() - begin_s
        spun_s = time.process_time() + 0.02
        while time.process_time() < spun_s:
            pass
        later = clock.now()
    assert after.wall_s - before.wall_s < 0.5 * took_s
    assert later.processor_s - after.processor_s >= 0.02
