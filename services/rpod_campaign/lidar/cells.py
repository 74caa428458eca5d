"""Cells of the LIDAR campaigns from the options that they share."""

from collections.abc import Iterator

from rpod_campaign.engine.options import either
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import METHODS, TEMPLATE_MATCHING, lidar_input
from rpod_campaign.lidar.options import CENTROID
from rpod_schemas.errors import ConfigurationError
from rpod_target import TargetError


def targets(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the targets if all can be loaded. Raises ConfigurationError."""
    for name in names:
        try:
            cached_target(name)
        except TargetError as error:
            raise ConfigurationError("--target", "", str(error)) from error
    return names


def methods(names: tuple[str, ...], known: tuple[str, ...] = METHODS) -> tuple[str, ...]:
    """Return the methods if all are known. Raises ConfigurationError."""
    for name in names:
        if name not in known:
            raise ConfigurationError("--method", "", f"needs {', '.join(known)}, not {name!r}")
    return names


def variants(
    method: str, *, steps: tuple[float, ...], centroid: str, matchers: tuple[str, ...]
) -> Iterator[tuple[float | None, str | None, str | None]]:
    """Yield template step, deg, centroid and matcher of template matching; None for other methods.

    Raises:
        ConfigurationError: this version lacks a method or a matcher.
    """
    if method not in TEMPLATE_MATCHING:
        lidar_input(method)
        yield None, None, None
        return
    for step_deg in steps:
        for position in either(centroid, CENTROID):
            for pairing in matchers:
                lidar_input(method, step_deg=step_deg, centroid=position, matcher=pairing)
                yield step_deg, position, pairing


def steps_of(method: str, steps: tuple[float, ...]) -> tuple[float | None, ...]:
    """Return the template steps of a method, deg; one None if it has none. Raises ConfigurationError."""
    chosen: tuple[float | None, ...] = steps if method in TEMPLATE_MATCHING else (None,)
    for step_deg in chosen:
        lidar_input(method, step_deg=step_deg, centroid="offset", matcher="nearest-neighbour")
    return chosen
