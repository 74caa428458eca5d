"""The line that searches the target in frames, as they are and under the usual first mistakes.

A mirrored image, another unit of length and the lens of another mode leave frames that look right. Only the
target's own shape shows them: the search finds it in most frames under the right assumption, and in few under
a wrong one. No truth is needed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

import numpy as np

from rpod_driver.check.observations import Observations
from rpod_driver.check.result import CheckResult, fail, ok, unchecked
from rpod_driver.check.sightings import points_of
from rpod_pose.methods import kind_methods, methods_of
from rpod_pose.ports import Acquirer
from rpod_schemas.config.estimator import LidarInput, PmdInput
from rpod_schemas.types import LidarScan, PmdFrame, SensorFrame
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
_INPUTS = {"pmd": PmdInput, "lidar": LidarInput}


@dataclass(frozen=True)
class Mistake:
    """A mistake of a driver, and the function that undoes it."""

    fault: str
    """Name in the catalogue."""
    text: str
    undo: Callable[[Any], SensorFrame]


def mirrored(frame: LidarScan | PmdFrame) -> LidarScan | PmdFrame:
    """Return a frame with left and right exchanged; reversed rows differ from it by a half turn only."""
    if isinstance(frame, LidarScan):
        points_m = frame.points_m * np.array([-1.0, 1.0, 1.0], np.float32)
        parts = {"points_m": points_m, "intensity": frame.intensity, "time_s": frame.time_s}
        if frame.organised:
            parts = {name: None if part is None else part[:, ::-1] for name, part in parts.items()}
        return frame.model_copy(update=parts)
    images = {name: getattr(frame, name) for name in ("depth_m", "amplitude", "saturated")}
    turned = {
        name: None if image is None else np.ascontiguousarray(image[:, ::-1])
        for name, image in images.items()
    }
    camera = frame.camera.model_copy(update={"cx": frame.camera.width - 1 - frame.camera.cx})
    return frame.model_copy(update=turned | {"camera": camera})


def scaled(factor: float) -> Callable[[Any], SensorFrame]:
    """Return what multiplies all distances of a frame."""

    def undo(frame: Any) -> SensorFrame:
        name = "points_m" if isinstance(frame, LidarScan) else "depth_m"
        copy: SensorFrame = frame.model_copy(update={name: getattr(frame, name) * np.float32(factor)})
        return copy

    return undo


def refocused(factor: float) -> Callable[[PmdFrame], SensorFrame]:
    """Return what multiplies the focal lengths of a frame."""

    def undo(frame: PmdFrame) -> SensorFrame:
        focal = {"fx": frame.camera.fx * factor, "fy": frame.camera.fy * factor}
        return frame.model_copy(update={"camera": frame.camera.model_copy(update=focal)})

    return undo


_MIRROR = Mistake("mirrored", "mirrored, or with rows or columns in reverse order", mirrored)
_UNITS = (1000.0, 0.001, 10.0, 0.1, 100.0, 4.0, 0.25)
"""Ratios of units that drivers use: 1 m, 0.1 m, 1 cm, 1 mm, 0.25 mm, 0.1 mm."""
_FOCAL = tuple(
    Mistake("lens_unscaled", f"with {factor:g} times the focal length", refocused(factor))
    for factor in (0.5, 2.0)
)


def _unit(factor: float) -> Mistake:
    return Mistake("millimetres", f"with distances divided by {factor:g}", scaled(1.0 / factor))


def searched(seen: Observations, target: Target, *, now_s: Callable[[], float] = monotonic) -> CheckResult:
    """Search the target in some of the frames, and name the mistake under which it is found."""
    if seen.kind not in _INPUTS:
        return unchecked(_LINE, f"no search for sensors of kind {seen.kind}")
    if len(seen.kept) < _FRAMES:
        return unchecked(_LINE, f"{len(seen.kept)} frames were read, {_FRAMES} are needed")
    places = np.linspace(0, len(seen.kept) - 1, _FRAMES).astype(int)
    chosen = [seen.kept[place].frame for place in places]
    sensor: Any = _INPUTS[seen.kind](source=seen.options.source)
    setup = kind_methods(sensor).setup(sensor, seen.newest_info)
    if setup is None:
        return unchecked(_LINE, kind_methods(sensor).missing)
    acquirer = methods_of(sensor, target, setup).acquirer
    shown = _width_m(chosen[0]) / (2.0 * _SHOWN * target.radius_m)
    units = sorted(_UNITS, key=lambda factor: abs(np.log(shown / factor)) if shown > 0.0 else 0.0)
    others = [*map(_unit, units[:1]), *(_FOCAL if seen.kind == "pmd" else ()), *map(_unit, units[1:])]
    return _judged(chosen, acquirer, others, now_s() + _TIME_S, now_s)


def _width_m(frame: SensorFrame) -> float:
    """Return the greatest width of what a frame shows along its sensor's axes, m; 0 if it shows nothing."""
    points_m = points_of(frame)
    if not len(points_m):
        return 0.0
    return float(np.ptp(np.percentile(points_m, (5.0, 95.0), axis=0), axis=0).max())


def _judged(
    frames: Sequence[SensorFrame],
    acquirer: Acquirer[Any],
    others: Sequence[Mistake],
    until_s: float,
    now_s: Callable[[], float],
) -> CheckResult:
    plain = [_found(acquirer, frame) for frame in frames[:_ENOUGH]]
    if any(plain):
        plain += [_found(acquirer, frame) for frame in frames[_ENOUGH:]]
    counts = {"found": float(sum(plain)), "searched": float(len(plain))}
    text = f"found in {sum(plain)} of {len(plain)} frames as they are"
    plain += [False] * (len(frames) - len(plain))
    tried = [_MIRROR, *(() if sum(plain) >= _NEEDED else others)]
    for mistake in tried:
        if now_s() > until_s:
            return unchecked(_LINE, f"{text}; not all mistakes were tried in {_TIME_S:.0f} s", **counts)
        found = _found_under(mistake, frames, acquirer)
        better = sum(here and not there for here, there in zip(found, plain, strict=False))
        worse = sum(there and not here for here, there in zip(found, plain, strict=False))
        if better >= _NEEDED and not worse:
            return fail(_LINE, f"{text}, in {sum(found)} {mistake.text}", mistake.fault, **counts)
        if mistake is _MIRROR and sum(plain) >= _NEEDED:
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
