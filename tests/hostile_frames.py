"""Frames and poses that the messages allow and no sensor sends, for every method.

As a program (``make bounds``) it tries ``FRAMES`` of each kind, with NUMBA_BOUNDSCHECK=1, by which compiled
code raises IndexError where it would read beyond an array. Kernels that are kept on disk are not checked, so
the program has a cache of its own. Compilation takes minutes. So the digest of the code that passed is kept
in ``CHECKED``, a part of the repository, and the same code is not checked again.
"""

import hashlib
import os
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of
from rpod_runtime.process.collector import process_starts
from rpod_schemas.config.estimator import LidarInput, PmdInput
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera, LidarScan, PmdFrame, PmdInfo
from rpod_target import load_target

CHECKED = Path(__file__).with_suffix(".sha256")
ROOT = Path(__file__).parents[1]
ROOMS = "services/rpod_pose", "sim_sensor/rpod_geometry", "sim_sensor/rpod_target", "schemas/rpod_schemas"
KINDS_OF_SENSOR = "lidar", "pmd"
FRAMES = 60
SIZES = ((1, 1), (2, 3), (40, 31), (64, 48))
LENGTHS_M = (0.0, -0.0, 1e-30, 1e-3, 0.06, 1.0, 4.0, 30.0, 1e4, 1e30, 3e38, -4.0, np.inf, -np.inf, np.nan)
FOCAL_PX = (0.01, 1.0, 90.0, 1e6)
COEFFICIENTS = (0.0, 0.1, -9.0, 1e4)
RANGES_M = (0.0, 1e-12, 0.3, 4.0, 25.0, 1e9)
HERTZ = (1e6, 20e6, 1e9)
KINDS = (np.uint8, np.uint16, np.float32)
SHARES = (0.0, 0.02, 0.6)


def depths(seed: int, shape: tuple[int, ...]) -> np.ndarray:
    """Return a smooth surface with values that are none strewn over a share of it."""
    rng = np.random.default_rng(seed)
    image = (rng.choice(LENGTHS_M) + 0.1 * rng.standard_normal(shape)).astype(np.float32)
    strewn = rng.random(shape) < rng.choice(SHARES)
    return np.where(strewn, rng.choice(LENGTHS_M, shape), image).astype(np.float32)


def pmd_frame(seed: int, camera: Camera) -> PmdFrame:
    """Return a frame of a camera."""
    rng, shape = np.random.default_rng(seed), (camera.height, camera.width)
    kind, amplitude = KINDS[seed % 3], None
    if kind is np.float32:
        amplitude = rng.choice(LENGTHS_M, shape).astype(kind)
    elif seed % 4:
        amplitude = rng.integers(0, np.iinfo(kind).max, shape).astype(kind)
    info = PmdInfo(
        modulation_frequency_hz=rng.choice(HERTZ, seed % 3),
        integration_time_s=1e-3,
        electrons_per_count=1.0,
        saturation_count=1e4,
    )
    return PmdFrame(
        stamp_ns=0, frame_id="", depth_m=depths(seed, shape), amplitude=amplitude, camera=camera, info=info
    )


def scan(seed: int) -> LidarScan:
    """Return a scan, organised or not, of the pattern's size or another."""
    rng = np.random.default_rng(seed)
    shape = ((11, 11), (5,), (0,), (90,), (7, 3), (1, 1))[seed % 6]
    middle_m = 0.0, 0.0, rng.choice(LENGTHS_M)
    points_m = rng.standard_normal((*shape, 3)) * rng.choice((1e-3, 1.0, 1e30)) + middle_m
    points_m[rng.random(shape) < rng.choice(SHARES)] = rng.choice(LENGTHS_M, 3)
    return LidarScan(stamp_ns=0, frame_id="", points_m=points_m.astype(np.float32))


def pose(seed: int) -> RigidTransform:
    """Return a prediction, near or far, in front or behind."""
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal(3) if seed % 2 else np.array([0.0, 0.0, 1.0])
    place_m = direction / np.linalg.norm(direction) * rng.choice(RANGES_M)
    return make_pose(rotation=Rotation.random(rng=rng), translation_m=place_m)


def methods(kind: str) -> Any:
    """Return the methods of a LIDAR of 11 x 11 rays, or of a PMD camera."""
    if kind == "pmd":
        return methods_of(PmdInput(), load_target("mockup"))
    angles_rad = np.deg2rad(np.linspace(-10.0, 10.0, 11))
    return methods_of(LidarInput(), load_target("envisat-bulky"), ScanPattern(angles_rad, angles_rad))


def attempt(found: Any, seen: PmdFrame | LidarScan, guess: RigidTransform) -> None:
    """Let methods see a frame: a refusal is a result, never an exception."""
    found.tracker.track(seen, guess)
    found.acquirer.acquire(seen)
    found.acquirer.near(seen, guess)


def camera_of(number: int) -> Camera:
    """Return a camera: a usual one two times in three."""
    rng = np.random.default_rng(number)
    (width, height), usual = SIZES[number % len(SIZES)], number % 3 > 0
    fx, fy = (90.0, 90.0) if usual else rng.choice(FOCAL_PX, 2).tolist()
    lens = np.zeros(5) if usual else rng.choice(COEFFICIENTS, 5)
    middle = (width - 1) / 2, (height - 1) / 2
    return Camera(width=width, height=height, fx=fx, fy=fy, cx=middle[0], cy=middle[1], distortion=lens)


def failures(numbers: Iterable[int], kind: str) -> Counter[str]:
    """Return what the methods of a kind of sensor raised, and how often."""
    found, raised = methods(kind), Counter[str]()
    for number in numbers:
        seen = pmd_frame(number, camera_of(number)) if kind == "pmd" else scan(number)
        try:
            attempt(found, seen, pose(number))
        except Exception as error:  # noqa: BLE001 - every kind is a finding
            last = [f for f in traceback.extract_tb(error.__traceback__) if "rpod_" in f.filename][-1]
            place = f"{Path(last.filename).name}:{last.lineno}"
            raised[f"{kind}: {type(error).__name__}: {error} at {place}"] += 1
    return raised


def digest_of_code(root: Path = ROOT) -> str:
    """Return the digest of all that decides what compiled code does with these frames."""
    paths = [path for room in ROOMS for kind in ("*.py", "*.yaml") for path in (root / room).rglob(kind)]
    paths += [root / "tests/hostile_frames.py", root / "deploy/supply/requirements.lock"]
    content = hashlib.sha256()
    for path in sorted(paths):
        content.update(f"{path.relative_to(root)} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return content.hexdigest()


if __name__ == "__main__":
    if os.environ.get("NUMBA_BOUNDSCHECK") != "1":
        sys.exit("no index is checked without NUMBA_BOUNDSCHECK=1: use make bounds")
    digest = digest_of_code()
    if CHECKED.read_text().strip() == digest:
        print(f"nothing has changed since the last check (tests/{CHECKED.name}; to check again, empty it)")  # noqa: T201
        sys.exit()
    process_starts()  # what a compiler makes stays: the collector would examine it again and again
    warnings.simplefilter("ignore")
    # One process for all kinds: what their kernels share is compiled once.
    found = sum((failures(range(FRAMES), kind) for kind in KINDS_OF_SENSOR), Counter[str]())
    print(*found.items(), sep="\n")  # noqa: T201
    if not found:
        CHECKED.write_text(f"{digest}\n")
    sys.exit(bool(found))
