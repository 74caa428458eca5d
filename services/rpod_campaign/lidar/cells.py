"""Cells of the LIDAR campaigns from the options that they share."""

from collections.abc import Iterator
from typing import Protocol

from rpod_campaign.engine.options import either
from rpod_campaign.engine.trial.names import require
from rpod_campaign.engine.trial.sizes import in_metres
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import METHODS, TEMPLATE_MATCHING, lidar_input
from rpod_campaign.lidar.options import CENTROID
from rpod_campaign.lidar.returns import COMMON_RETURNS, range_of_returns
from rpod_schemas.errors import ConfigurationError
from rpod_target import TargetError, is_shipped


def targets(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the targets if all can be loaded. Raises ConfigurationError."""
    for name in names:
        try:
            cached_target(name)
        except TargetError as error:
            raise ConfigurationError("--target", "", str(error)) from error
    return names


class RangedOptions(Protocol):
    """Options of a campaign at fixed ranges; each campaign has its own default."""

    @property
    def ranges(self) -> tuple[float | str, ...]:
        """Ranges in metres, or in the target's longest sides (``3x``)."""
        ...

    @property
    def model_fields_set(self) -> set[str]:
        """Names of the options that are given."""
        ...


def ranges_m(options: RangedOptions, target: str) -> tuple[float, ...]:
    """Return the ranges of a campaign's option, m.

    If it is not given, those of a shipped target are the option's default, and those of another target give
    500 to 30 returns on average.
    """
    loaded = cached_target(target)
    if "ranges" in options.model_fields_set or is_shipped(loaded):
        return in_metres(options.ranges, loaded)
    return tuple(dict.fromkeys(range_of_returns(target, returns) for returns in COMMON_RETURNS))


def methods(names: tuple[str, ...], known: tuple[str, ...] = METHODS) -> tuple[str, ...]:
    """Return the methods if all are known. Raises ConfigurationError."""
    for name in names:
        require("--method", name, known)
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
