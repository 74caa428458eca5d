"""Prints how well tracks are predicted through gaps, for each course as many seeds as asked."""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from rich.console import Console

from free_flight.course import AT_THEIR_WORD, Course, Result, fly
from rpod_schemas.config.motion import CommandErrorConfig, ImuNoiseConfig
from rpod_target import load_target

_WRONG = {"right": (1.0, 1.0, 1.0), "largest +20 %": (1.0, 1.0, 1.2), "largest -20 %": (1.0, 1.0, 0.8),
          "middle +20 %": (1.0, 1.2, 1.0), "least +20 %": (1.2, 1.0, 1.0)}  # fmt: skip
_TORQUE_FREE = {"target": "torque_free"}
_IMU = ImuNoiseConfig()
_TRACKED = _IMU.model_copy(update={"star_tracker_sigma_deg": 0.01})
_PRECISE = ImuNoiseConfig(acceleration_noise_m_s_sqrt_s=3e-5, acceleration_bias_sigma_m_s2=1e-4)


def courses() -> Iterator[tuple[str, Course]]:
    """Yield the courses with their names."""
    envisat, mockup = load_target("envisat-bulky"), load_target("mockup")
    for rate_deg_s in (5.0, 8.0):
        scans = Course(
            envisat, rate_deg_s, _TORQUE_FREE, range_m=40.0, scans_hz=1.0, sigma_m=0.02, tracked_s=120.0
        )
        for wrong, moments in _WRONG.items():
            yield (
                f"{rate_deg_s:g} deg/s, scans, 60 s ahead, inertia {wrong}",
                replace(scans, moments=moments, gap_s=60.0),
            )
        unsure = {**_TORQUE_FREE, "centre_of_mass_sigma_m": 0.05}
        for name, course in (("scans", scans), ("camera", Course(mockup, rate_deg_s, _TORQUE_FREE))):
            yield f"{rate_deg_s:g} deg/s, {name}, 30 s gap", course
            yield (
                f"{rate_deg_s:g} deg/s, {name}, 30 s gap, inertia and centre wrong",
                replace(course, dynamics=unsure, moments=(1.0, 1.0, 1.2), centre_off_m=(0.05, -0.03, 0.04)),
            )
    orbit = Course(
        envisat, 5.0, {**_TORQUE_FREE, "orbit": {"period_s": 6009.6}, "imu": {}}, scans_hz=1.0,
        sigma_m=0.02, tracked_s=120.0, in_orbit=True, imu=_TRACKED,
    )  # fmt: skip
    yield "5 deg/s, scans, 30 s gap, on a safety ellipse, orbit and gyro", orbit
    yield "5 deg/s, scans, 60 s gap, on a safety ellipse, orbit and gyro", replace(orbit, gap_s=60.0)
    camera = Course(mockup, 5.0, {}, gap_s=0.0, filter=AT_THEIR_WORD)
    yield "5 deg/s, camera, constant rate, no slew", camera
    yield "5 deg/s, camera, constant rate, slew 1 deg/s", replace(camera, slews=True)
    yield (
        "5 deg/s, camera, constant rate, slew 1 deg/s, gyro",
        replace(camera, slews=True, dynamics={"imu": {}}, imu=_IMU),
    )
    quiet = Course(mockup, 5.0, _TORQUE_FREE)
    yield "5 deg/s, camera, torque-free, no slew", quiet
    yield "5 deg/s, camera, torque-free, slew 1 deg/s, no gyro", replace(quiet, slews=True, gap_s=0.0)
    scans = Course(
        envisat, 5.0, _TORQUE_FREE, range_m=40.0, scans_hz=1.0, sigma_m=0.02, tracked_s=120.0,
        slews=True, gap_s=0.0, filter=AT_THEIR_WORD,
    )  # fmt: skip
    yield "5 deg/s, scans, torque-free, slew 1 deg/s, no gyro", scans
    yield "5 deg/s, scans, constant rate, slew 1 deg/s", replace(scans, dynamics={})
    yield (
        "5 deg/s, camera, torque-free, slew 1 deg/s, gyro",
        replace(quiet, slews=True, dynamics={**_TORQUE_FREE, "imu": {}}, imu=_IMU),
    )
    forced = {**_TORQUE_FREE, "imu": {"acceleration_bias_sigma_m_s2": 1e-4}}
    yield (
        "5 deg/s, camera, torque-free, slew 1 deg/s, gyro and accelerometer",
        replace(quiet, slews=True, dynamics=forced, imu=_PRECISE, filter=AT_THEIR_WORD),
    )
    thrusting = replace(quiet, approach_m=3.0, thrusts=True, filter=AT_THEIR_WORD)
    commanded = {**_TORQUE_FREE, "command": {}}
    for name, dynamics, imu in (
        ("no source", _TORQUE_FREE, None),
        ("gyro and accelerometer", forced, _PRECISE),
        ("command", commanded, None),
    ):
        course = replace(thrusting, dynamics=dynamics, imu=imu, commands=CommandErrorConfig())
        yield f"5 deg/s, camera, torque-free, thrust in the gap, {name}", course
    yield (
        "5 deg/s, camera, torque-free, thrust in the gap, slew 1 deg/s, gyro and command",
        replace(
            thrusting, slews=True, dynamics={**commanded, "imu": {}}, imu=_IMU, commands=CommandErrorConfig()
        ),
    )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--only", default="", help="part of the names of the courses to fly")
    arguments = parser.parse_args()
    out = Console(soft_wrap=True, highlight=False)
    out.print(f"{arguments.seeds} seeds a row, from 1; errors at the end of the gap")
    out.print(
        "deg p50, p95, max | mm p50, p95, max | sigma deg, mm | NEES | tracked deg, mm, NEES | worst deg, mm"
        " | refused"
    )
    for name, course in courses():
        if arguments.only in name:
            found = [fly(course, seed) for seed in range(1, arguments.seeds + 1)]
            out.print(f"{name}: {_row(found)}")


def _row(found: list[Result]) -> str:
    deg = np.array([each.attitude_deg for each in found])
    mm = 1e3 * np.array([each.position_m for each in found])
    sigma = np.median([(each.sigma_deg, 1e3 * each.sigma_m) for each in found], axis=0)
    tracked = np.mean([(each.tracked_deg, 1e3 * each.tracked_m, each.tracked_nees) for each in found], axis=0)
    worst = np.max([(each.worst_deg, 1e3 * each.worst_m) for each in found], axis=0)
    return " | ".join(
        (
            ", ".join(f"{value:.3f}" for value in (np.median(deg), np.quantile(deg, 0.95), deg.max())),
            ", ".join(f"{value:.1f}" for value in (np.median(mm), np.quantile(mm, 0.95), mm.max())),
            f"{sigma[0]:.3f}, {sigma[1]:.1f}",
            f"{np.mean([each.nees for each in found]):.1f}",
            f"{tracked[0]:.3f}, {tracked[1]:.2f}, {tracked[2]:.1f}",
            f"{worst[0]:.2f}, {worst[1]:.0f}",
            str(sum(each.refused for each in found)),
        )
    )


if __name__ == "__main__":
    main()
