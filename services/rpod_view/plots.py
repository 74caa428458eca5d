"""The estimator over time: errors, 3 sigma bands, range, processing time, and its state."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import rerun as rr

from rpod_schemas.types import EstimatorStatus, Integrity, IntegrityState, Mode
from rpod_view import palette
from rpod_view.layout import ATTITUDE, EVENTS, POSITION, PROCESSING, RANGE, STATE, TIMELINE
from rpod_view.scene import Scored
from rpod_view.shading import MILLIMETRES, band
from rpod_view.summary import SOURCES

_ERROR, _BAND, _LEVEL = "error", "band", "level"
_NAMES = {
    f"{POSITION}/{_ERROR}": ("error", palette.ESTIMATE),
    f"{POSITION}/{_BAND}": ("3 sigma, worst axis", palette.QUIET),
    f"{POSITION}/{_LEVEL}": ("protection level, up to the alert limit", palette.ELLIPSOID),
    f"{ATTITUDE}/{_ERROR}": ("error", palette.ESTIMATE),
    f"{ATTITUDE}/{_BAND}": ("3 sigma, worst axis", palette.QUIET),
    f"{ATTITUDE}/{_LEVEL}": ("protection level, up to the alert limit", palette.ELLIPSOID),
    PROCESSING: ("frame to estimate, in TRACKING", palette.ACCENT),
    RANGE: ("range of the target", palette.ACCENT),
}
_LEVELS = {
    Mode.ACQUIRING: rr.TextLogLevel.INFO,
    Mode.VERIFYING: rr.TextLogLevel.INFO,
    Mode.TRACKING: rr.TextLogLevel.INFO,
    Mode.LOST: rr.TextLogLevel.ERROR,
    Mode.COASTING: rr.TextLogLevel.WARN,
}
_INTEGRITY_LEVELS = {
    IntegrityState.UNAVAILABLE: rr.TextLogLevel.WARN,
    IntegrityState.NOMINAL: rr.TextLogLevel.INFO,
    IntegrityState.CAUTION: rr.TextLogLevel.WARN,
    IntegrityState.ALERT: rr.TextLogLevel.ERROR,
}
_Sample = tuple[int, float]


class Plots:
    """Writes time series and events into a recording."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        self._shown: dict[str, str] = {}
        for path, (name, colour) in _NAMES.items():
            recording.log(path, rr.SeriesLines(names=name, colors=colour, widths=1.5), static=True)
        recording.log(f"{STATE}/mode", _lane({mode.name: palette.MODES[mode] for mode in Mode}), static=True)
        recording.log(
            f"{STATE}/source",
            _lane({SOURCES[source]: colour for source, colour in palette.SOURCES.items()}),
            static=True,
        )
        recording.log(
            f"{STATE}/acceptance",
            _lane({"accepted": palette.MODES[Mode.TRACKING], "rejected": palette.MODES[Mode.LOST]}),
            static=True,
        )
        lane = _lane({state.name: palette.INTEGRITY[state] for state in IntegrityState})
        recording.log(f"{STATE}/integrity", lane, static=True)

    def estimates(self, scored: Sequence[Scored]) -> None:
        """Add the errors of estimates, their bands, and the range."""
        self._series(f"{POSITION}/{_ERROR}", scored, _position_error_mm)
        self._series(f"{ATTITUDE}/{_ERROR}", scored, _attitude_error_deg)
        self._series(
            f"{POSITION}/{_BAND}",
            scored,
            lambda each: MILLIMETRES * band(each.estimate.pose_covariance[:3, :3]),
        )
        self._series(
            f"{ATTITUDE}/{_BAND}",
            scored,
            lambda each: float(np.rad2deg(band(each.estimate.pose_covariance[3:, 3:]))),
        )
        self._series(RANGE, scored, lambda each: float(np.linalg.norm(each.estimate.pose.translation)))

    def _series(self, path: str, scored: Sequence[Scored], value: Callable[[Scored], float | None]) -> None:
        samples = [(each.estimate.stamp_ns, found) for each in scored if (found := value(each)) is not None]
        self._add(path, samples)

    def _add(self, path: str, samples: Sequence[_Sample]) -> None:
        if samples:
            stamps_ns, values = zip(*samples, strict=True)
            index = rr.TimeColumn(TIMELINE, timestamp=np.array(stamps_ns, "datetime64[ns]"))
            self._recording.send_columns(path, [index], rr.Scalars.columns(scalars=np.array(values)))

    def statuses(self, statuses: Iterable[EstimatorStatus]) -> None:
        """Add the estimator's processing times and the changes of its state."""
        processing: list[_Sample] = []
        for status in statuses:
            if status.mode.has_track and np.isfinite(status.processing_s):
                processing.append((status.stamp_ns, 1e3 * status.processing_s))
            self._note(status)
        self._add(PROCESSING, processing)

    def integrities(self, told: Sequence[Integrity]) -> None:
        """Add protection levels and the changes of the integrity's state.

        A level above its alert limit is a gap in its curve: it may be a thousand times as large as an error.
        """
        for name, of in ((POSITION, _position_level_mm), (ATTITUDE, _attitude_level_deg)):
            self._add(f"{name}/{_LEVEL}", [(each.stamp_ns, of(each)) for each in told])
        for each in told:
            self._recording.set_time(TIMELINE, timestamp=np.datetime64(each.stamp_ns, "ns"))
            if self._change("integrity", each.state.name):
                text = f"integrity {each.state.name}" + (f": {each.reason}" if each.reason else "")
                self._event(text, _INTEGRITY_LEVELS[each.state])

    def _note(self, status: EstimatorStatus) -> None:
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(status.stamp_ns, "ns"))
        if self._change("mode", status.mode.name):
            self._event(f"{status.mode.name}", _LEVELS[status.mode])
        if status.sensor:
            self._change("source", SOURCES[status.source])
            self._change("acceptance", "accepted" if status.accepted else "rejected")
            if not status.accepted and self._is_new("reason", status.reason.partition(":")[0]):
                self._event(f"{status.sensor} rejected: {status.reason}", rr.TextLogLevel.WARN)

    def _change(self, lane: str, state: str) -> bool:
        if is_new := self._is_new(lane, state):
            self._recording.log(f"{STATE}/{lane}", rr.StateChange(state=state))
        return is_new

    def _is_new(self, lane: str, state: str) -> bool:
        before = self._shown.get(lane)
        self._shown[lane] = state
        return state != before

    def _event(self, text: str, level: rr.TextLogLevel) -> None:
        self._recording.log(EVENTS, rr.TextLog(text, level=level.value))


def _lane(colours: dict[str, tuple[int, int, int]]) -> rr.StateConfiguration:
    return rr.StateConfiguration(values=list(colours), labels=list(colours), colors=list(colours.values()))


def _position_level_mm(told: Integrity) -> float:
    level_m = told.position_level_m
    return MILLIMETRES * level_m if level_m <= told.position_limit_m else float("nan")


def _attitude_level_deg(told: Integrity) -> float:
    level_deg = told.attitude_level_deg
    return level_deg if level_deg <= told.attitude_limit_deg else float("nan")


def _position_error_mm(scored: Scored) -> float | None:
    return None if scored.position_m is None else MILLIMETRES * float(np.linalg.norm(scored.position_m))


def _attitude_error_deg(scored: Scored) -> float | None:
    return None if scored.attitude_rad is None else float(np.rad2deg(np.linalg.norm(scored.attitude_rad)))
