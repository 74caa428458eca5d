"""The line that searches the target in frames, as they are and under the usual first mistakes.

A mirrored image, another unit of length and the lens of another mode leave frames that look right. Only the
target's own shape shows them: the search finds it in most frames under the right assumption, and in few under
a wrong one. No truth is needed.
"""

from collections.abc import Callable, Sequence
from functools import partial
from time import monotonic
from typing import Any

import numpy as np

from rpod_driver.check.kinds import checks_of
from rpod_driver.check.observations import Observations
from rpod_driver.check.result import CheckResult, fail, ok, unchecked
from rpod_driver.check.sightings import points_of
from rpod_driver.mistakes import Mistake
from rpod_pose.methods import kind_methods, methods_of
from rpod_pose.ports import Acquirer
from rpod_pose.surroundings.frames import Frames
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.types import SensorFrame
from rpod_target import Target

_LINE = "target"
_FRAMES = 8
_NEEDED = 4
"""Number of frames that one assumption must explain and the other must not: by chance, once in 16 cases."""
_ENOUGH = 3
"""Number of first frames after which the search of frames as they are ends, if none shows the target."""
_SHOWN = 0.7
"""Width of a body in a view over its diameter. Units are tried in the order of how well they give this
width."""
_TIME_S = 180.0
"""Time after which no further assumption is tried, s; a search in a frame of another unit takes seconds."""
_UNITS = (1000.0, 0.001, 10.0, 0.1, 100.0, 4.0, 0.25)
"""Ratios of units that drivers use: 1 m, 0.1 m, 1 cm, 1 mm, 0.25 mm, 0.1 mm."""


def searched(seen: Observations, target: Target, *, now_s: Callable[[], float] = monotonic) -> CheckResult:
    """Search the target in some of the frames, and name the mistake under which it is found."""
    checks, kind = checks_of(seen.kind), sensor_kind(seen.kind)
    if checks.mirrored is None:
        return unchecked(_LINE, f"no search for sensors of kind {seen.kind}")
    if len(seen.kept) < _FRAMES:
        return unchecked(_LINE, f"{len(seen.kept)} frames were read, {_FRAMES} are needed")
    places = np.linspace(0, len(seen.kept) - 1, _FRAMES).astype(int)
    chosen = [seen.kept[place].frame for place in places]
    sensor: Any = kind.heard.model_validate({"source": seen.options.source})
    of_kind = kind_methods(sensor)
    setup = of_kind.setup(sensor, seen.newest_info)
    if setup is None:
        return unchecked(_LINE, of_kind.missing)
    acquirer = methods_of(sensor, target, setup).acquirer
    shown = _width_m(chosen[0]) / (2.0 * _SHOWN * target.radius_m)
    factors = sorted(_UNITS, key=lambda factor: abs(np.log(shown / factor)) if shown > 0.0 else 0.0)
    units = _units(factors, of_kind.separation and of_kind.separation(sensor, setup))
    tried = [checks.mirrored, *units[:1], *checks.mistakes, *units[1:]]
    return _compared(chosen, acquirer, tried, now_s() + _TIME_S, now_s)


def _units(factors: Sequence[float], frames: Frames[Any] | None) -> list[Mistake]:
    """Return the mistakes of distances in another unit; none for a kind whose frames cannot be scaled."""
    if frames is None:
        return []
    return [
        Mistake("millimetres", f"with distances divided by {factor:g}", partial(frames.nearer, ratio=factor))
        for factor in factors
    ]


def _width_m(frame: SensorFrame) -> float:
    """Return the greatest width of what a frame shows along its sensor's axes, m; 0 if it shows nothing."""
    points_m = points_of(frame)
    if not len(points_m):
        return 0.0
    return float(np.ptp(np.percentile(points_m, (5.0, 95.0), axis=0), axis=0).max())


def _compared(
    frames: Sequence[SensorFrame],
    acquirer: Acquirer[Any],
    mistakes: Sequence[Mistake],
    until_s: float,
    now_s: Callable[[], float],
) -> CheckResult:
    plain = [_found(acquirer, frame) for frame in frames[:_ENOUGH]]
    if any(plain):
        plain += [_found(acquirer, frame) for frame in frames[_ENOUGH:]]
    counts = {"found": float(sum(plain)), "searched": float(len(plain))}
    text = f"found in {sum(plain)} of {len(plain)} frames as they are"
    plain += [False] * (len(frames) - len(plain))
    mirror = mistakes[0]
    for mistake in mistakes[:1] if sum(plain) >= _NEEDED else mistakes:
        if now_s() > until_s:
            return unchecked(_LINE, f"{text}; not all mistakes were tried in {_TIME_S:.0f} s", **counts)
        found = _found_under(mistake, frames, acquirer)
        better = sum(here and not there for here, there in zip(found, plain, strict=False))
        worse = sum(there and not here for here, there in zip(found, plain, strict=False))
        if better >= _NEEDED and not worse:
            return fail(_LINE, f"{text}, in {sum(found)} {mistake.text}", mistake.fault, **counts)
        if mistake is mirror and sum(plain) >= _NEEDED:
            told = f"{text}, in {sum(found)} mirrored"
            if worse >= _NEEDED and not better:
                return ok(_LINE, told, **counts)
            return unchecked(_LINE, f"{told}: its shape does not tell; let it show other sides", **counts)
    return unchecked(
        _LINE, f"{text}, and under no usual mistake; is it in view, and the right one?", **counts
    )


def _found_under(mistake: Mistake, frames: Sequence[SensorFrame], acquirer: Acquirer[Any]) -> list[bool]:
    """Return in which frames the target is found, up to where too few are left."""
    found: list[bool] = []
    for number, frame in enumerate(frames):
        found.append(_found(acquirer, mistake.undo(frame)))
        if found.count(False) > len(frames) - _NEEDED and number < len(frames) - 1:
            return found + [False] * (len(frames) - number - 1)
    return found


def _found(acquirer: Acquirer[Any], frame: SensorFrame) -> bool:
    return acquirer.acquire(frame).begins_track
