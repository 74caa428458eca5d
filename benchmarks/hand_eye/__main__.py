"""``python -m benchmarks.hand_eye``: errors of mount, holder and clock against what was put in.

For each seed a minute of ``mockup-calibration`` is emulated with a mount, a holder and an offset and drift of
the clock drawn at random, and measured frame by frame by the estimator's own method; no bus, no log. The
truth is taken with three errors. ``--keep DIR`` keeps the poses, so that fits are repeated without frames.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.spatial.transform import RigidTransform, Rotation

from rpod.scenarios import find
from rpod_analysis.calibration.hand_eye.fit import fit_hand_eye
from rpod_analysis.calibration.hand_eye.parameters import (
    DEPTH,
    DRIFT,
    HOLDER_M,
    HOLDER_RAD,
    MOUNT_M,
    MOUNT_RAD,
    OFFSET,
    Assumptions,
    HandEye,
)
from rpod_analysis.calibration.hand_eye.poses import StampedPoses
from rpod_estimator.estimator import Estimator
from rpod_estimator.frame_reader import Arrived
from rpod_motion import Motion, build_motion
from rpod_motion.truth_error import TruthError
from rpod_pose.measurement import Measurement
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.motion import TruthErrorConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.poses import chained, make_pose
from rpod_schemas.types import PmdFrame
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

TRUTHS = {
    "0.2 mm, 0.01 deg, independent": TruthErrorConfig(
        sigma_position_m=2e-4, sigma_attitude_deg=0.01, correlation_s=0.0
    ),
    "1.56 mm, 0.2 deg, independent": TruthErrorConfig(correlation_s=0.0),
    "1.56 mm, 0.2 deg, over 1 s": TruthErrorConfig(correlation_s=1.0),
}
DEPTH_SIGMA_M = 0.007
"""What the tracker assumes of calibrated ranges."""


def main() -> None:
    """Emulate, fit, and print one line a truth and seed, and one a truth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    console = Console(soft_wrap=True, highlight=False)
    errors: dict[str, list[FloatArray]] = {name: [] for name in TRUTHS}
    bounds: dict[str, list[FloatArray]] = {name: [] for name in TRUTHS}
    for seed in range(1, given.seeds + 1):
        put_in = _Errors(seed)
        seen = _kept(given.keep, put_in, given.seconds)
        for name, config in TRUTHS.items():
            found = fit_hand_eye(
                _stamped_late(seen, put_in, given.seconds),
                _truth(config, put_in, given.seconds),
                Assumptions(depth_sigma_m=DEPTH_SIGMA_M),
            )
            wrong = put_in.difference(found)
            errors[name].append(wrong)
            bounds[name].append(np.sqrt(np.diag(found.independent)))
            console.print(
                f"{name}, seed {seed}: {_told(wrong)}; sigma {_told(np.sqrt(np.diag(found.covariance)))}; "
                f"bound {_told(np.sqrt(np.diag(found.independent)))}; "
                f"depth correlation {found.depth_correlation:.3f}, boresight alone "
                f"{1e3 * found.boresight_sigma_m:.2f} mm, residual scale {found.scale:.2f}, blocks "
                f"{found.block_correlation:.2f}"
            )
    for name, wrongs in errors.items():
        console.print(f"{name}, RMS: {_told(_rms(wrongs))}; Cramer-Rao bound: {_told(_rms(bounds[name]))}")


def _rms(vectors: list[FloatArray]) -> FloatArray:
    rms: FloatArray = np.sqrt(np.mean(np.square(vectors), axis=0))
    return rms


def _told(values: FloatArray) -> str:
    def size(places: slice) -> float:
        return float(np.linalg.norm(values[places]))

    return (
        f"mount {1e3 * size(MOUNT_M):.2f} mm (across {1e3 * np.hypot(values[0], values[1]):.2f}, along "
        f"{1e3 * abs(values[2]):.2f}) {np.degrees(size(MOUNT_RAD)):.3f} deg, holder "
        f"{1e3 * size(HOLDER_M):.2f} mm {np.degrees(size(HOLDER_RAD)):.3f} deg, clock "
        f"{1e3 * abs(values[OFFSET]):.3f} ms {1e6 * abs(values[DRIFT]):.1f} ppm, depth "
        f"{1e3 * abs(values[DEPTH]):.2f} mm"
    )


class _Errors:
    """What is put in: nearly aligned mounts, as a laboratory has them, so that z is the boresight."""

    def __init__(self, seed: int) -> None:
        generator = np.random.default_rng((seed, 1))
        self.seed = seed
        self.T_chaser_sensor = _small(generator, 5.0, 0.15)
        self.T_holder_target = _small(generator, 20.0, 0.1)
        self.offset_s, self.drift = generator.uniform(-0.03, 0.03), generator.uniform(-5e-5, 5e-5)

    def difference(self, found: HandEye) -> FloatArray:
        """Return found minus put in, shape (15,); the depth offset is the emulator's wiggling, not known."""
        wrong = np.zeros(15)
        state = found.state
        wrong[MOUNT_M] = state.t_X - self.T_chaser_sensor.translation
        wrong[MOUNT_RAD] = _turn(state.R_X, self.T_chaser_sensor)
        wrong[HOLDER_M] = state.t_Y - self.T_holder_target.translation
        wrong[HOLDER_RAD] = _turn(state.R_Y, self.T_holder_target)
        wrong[OFFSET], wrong[DRIFT] = state.offset_s - self.offset_s, state.drift - self.drift
        wrong[DEPTH] = state.depth_m
        return wrong


def _small(generator: np.random.Generator, deg: float, m: float) -> RigidTransform:
    turn = Rotation.from_rotvec(np.radians(generator.normal(0.0, deg, 3)))
    return make_pose(rotation=turn, translation_m=generator.normal(0.0, m, 3))


def _turn(R: FloatArray, pose: RigidTransform) -> FloatArray:
    return (Rotation.from_matrix(R) * pose.rotation.inv()).as_rotvec()


def _motion(scenario: Scenario) -> Motion:
    target = load_target(scenario.target)
    return build_motion(
        scenario.motion,
        centre_of_mass_m=target.centre_of_mass_m,
        inertia_kg_m2=target.inertia_kg_m2,
        duration_s=scenario.duration_s,
    )


def _kept(folder: Path | None, put_in: _Errors, seconds: float) -> StampedPoses:
    file = folder / f"seed-{put_in.seed}.npz" if folder else None
    if file is None or not file.exists():
        seen = list(_measured(put_in, seconds))
        stamps, poses, covariances = zip(*seen, strict=True)
        matrices = np.stack([pose.as_matrix() for pose in poses])
        arrays = np.array(stamps, np.int64), matrices[:, :3, :3], matrices[:, :3, 3], np.stack(covariances)
        if file is None:
            return StampedPoses(*arrays)
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(file, *arrays)
    with np.load(file) as kept:
        return StampedPoses(*(kept[f"arr_{index}"] for index in range(4)))


def _measured(put_in: _Errors, seconds: float) -> Iterator[tuple[int, RigidTransform, FloatArray]]:
    """Yield stamp, T_sensor_target and covariance of each measured frame."""
    scenario = find("mockup-calibration")
    motion, target, camera = _motion(scenario), load_target(scenario.target), scenario.sensors[0]
    if not isinstance(camera, PmdConfig):
        raise TypeError(type(camera))
    emulator = PmdEmulator(camera, target, seed=put_in.seed)
    hearing = scenario.estimator.sensors[0].informed_by(camera)
    settings = {"filter": scenario.estimator.filter, "navigator": scenario.estimator.navigator}
    estimator = Estimator(EstimatorConfig(target=scenario.target, sensors=(hearing,), **settings), target)
    estimator.learn({hearing.name: camera.info()})
    T_sensor_chaser = put_in.T_chaser_sensor.inv()
    for number in range(1, int(seconds * camera.rate_hz)):
        time_s = number / camera.rate_hz
        poses = [
            chained(T_sensor_chaser, motion.state(time_s + offset_s).T_chaser_target)
            for offset_s in camera.pose_times_s()
        ]
        exposed = emulator.expose(poses, sun_W_m2=np.zeros(3), frame=number)
        stamp_ns = round(1e9 * time_s)
        frame = PmdFrame(
            stamp_ns=stamp_ns,
            frame_id=hearing.name,
            camera=camera.camera,
            depth_m=exposed.depth_m.copy(),
            amplitude=exposed.amplitude.copy(),
            info=camera.info(),
        )
        output = estimator.process(
            Arrived(hearing.name, stamp_ns, 0.0, Measurement(hearing.name, frame, make_pose()))
        )
        if output.measured is not None and output.measured.T_sensor_target is not None:
            yield stamp_ns, output.measured.T_sensor_target, output.measured.covariance


def _stamped_late(seen: StampedPoses, put_in: _Errors, seconds: float) -> StampedPoses:
    """Return the poses with the stamps of a clock that is ahead and drifts."""
    ahead_s = put_in.offset_s + put_in.drift * (1e-9 * seen.stamp_ns - 0.5 * seconds)
    return StampedPoses(
        seen.stamp_ns + np.round(1e9 * ahead_s).astype(np.int64), seen.R, seen.t_m, seen.covariance
    )


def _truth(config: TruthErrorConfig, put_in: _Errors, seconds: float) -> StampedPoses:
    """Return T_chaser_holder at 250 Hz, with its error."""
    motion = _motion(find("mockup-calibration"))
    error = TruthError(config, seed=put_in.seed, rate_hz=250.0)
    ticks = np.arange(-20, round(250.0 * seconds) + 20)
    T_target_holder = put_in.T_holder_target.inv()
    matrices = np.stack(
        [
            error.perturb(chained(motion.state(tick / 250.0).T_chaser_target, T_target_holder)).as_matrix()
            for tick in ticks
        ]
    )
    covariance = np.tile(error.covariance, (ticks.size, 1, 1))
    return StampedPoses(ticks * 4_000_000, matrices[:, :3, :3], matrices[:, :3, 3], covariance)


if __name__ == "__main__":
    main()
