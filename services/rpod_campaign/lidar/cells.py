"""What the LIDAR campaigns make of the options that they share."""

from collections.abc import Iterator

from rpod_campaign.engine.campaign import Options
from rpod_campaign.lidar.methods import METHODS, TEMPLATE_MATCHING, lidar_input
from rpod_schemas.errors import ConfigurationError
from rpod_target import TargetError, load_target

DEFAULT_METHODS = ("global",)


def targets(options: Options, default: tuple[str, ...]) -> tuple[str, ...]:
    """Return the targets, each of which can be loaded. Raises ConfigurationError."""
    names = options.target or default
    for name in names:
        try:
            load_target(name)
        except TargetError as error:
            raise ConfigurationError("--target", "", str(error)) from error
    return names


def methods(options: Options, default: tuple[str, ...], known: tuple[str, ...] = METHODS) -> tuple[str, ...]:
    """Return the methods. Raises ConfigurationError."""
    names = options.method or default
    for name in names:
        if name not in known:
            raise ConfigurationError("--method", "", f"needs {', '.join(known)}, not {name!r}")
    return names


def variants(
    method: str, options: Options, *, steps: tuple[float, ...], centroid: str, matcher: str
) -> Iterator[tuple[float | None, str | None, str | None]]:
    """Yield template step, centroid and matcher of template matching, nothing of other methods.

    Each is tried for a configuration: a method or matcher that this version lacks is refused here.
    """
    if method not in TEMPLATE_MATCHING:
        lidar_input(method)
        yield None, None, None
        return
    for step_deg in options.steps or steps:
        for position in options.both("centroid", centroid):
            for pairing in options.matcher or (matcher,):
                lidar_input(method, step_deg=step_deg, centroid=position, matcher=pairing)
                yield step_deg, position, pairing


def steps_of(method: str, options: Options, default_deg: float = 30.0) -> tuple[float | None, ...]:
    """Return the template steps of a method, one None where it has none. Raises ConfigurationError."""
    steps = (options.steps or (default_deg,)) if method in TEMPLATE_MATCHING else (None,)
    for step_deg in steps:
        lidar_input(method, step_deg=step_deg, centroid="offset", matcher="nearest-neighbour")
    return steps
