"""Lines of the check that depend on the sensor's kind; a kind of another package may bring its own."""

from collections.abc import Callable
from dataclasses import dataclass

from rpod_driver.check import content, plane, setup
from rpod_driver.check.observations import Observations
from rpod_driver.check.result import CheckResult
from rpod_driver.mistakes import FOCAL_LENGTHS, MIRRORED_IMAGE, MIRRORED_SCAN, Mistake
from rpod_schemas.registry import resolve
from rpod_schemas.sensors import sensor_kind


@dataclass(frozen=True)
class KindChecks:
    """Checks for the sensors of one kind, beside those for all sensors."""

    lines: tuple[Callable[[Observations], CheckResult], ...] = (setup.mirrored,)
    """Functions that return a line each, in the order of the catalogue."""
    farthest_m: float = 1000.0
    """Greatest plausible median distance, m: no flash camera and no scanner sees a target beyond it."""
    why: str = "no scanner of a facility sees farther"
    """Reason for it."""
    mirrored: Mistake | None = None
    """Mistake of mirrored frames; without it, ``--search`` does not search the target in the frames."""
    mistakes: tuple[Mistake, ...] = ()
    """Further mistakes under which the target is searched, beside another unit of length."""


LIDAR_CHECKS = KindChecks((setup.grid, setup.axes, setup.point_times), mirrored=MIRRORED_SCAN)
PMD_CHECKS = KindChecks(
    (setup.mirrored, content.values, content.saturation, content.exposure, plane.depth_model, setup.lens),
    farthest_m=100.0,
    why="no camera with a lamp sees farther",
    mirrored=MIRRORED_IMAGE,
    mistakes=FOCAL_LENGTHS,
)


def checks_of(kind: str) -> KindChecks:
    """Return the checks of a kind; for a kind without checks of its own, those for any sensor."""
    reference = sensor_kind(kind).checks
    checks: KindChecks = resolve(reference) if reference else KindChecks()
    return checks
