"""Whether the clock of a sensor was set: its stamps jump, while its frames arrive as before.

A delay and a clock that was set back both make a frame look older on its arrival. They differ in what stays
regular. A delayed frame has the expected stamp, and arrives late. A frame whose clock was set arrives when
expected, with an unexpected stamp; or its stamp is before that of the previous frame, which no delay can
cause. What counts as regular is what the sensor itself has shown: each limit follows from the scatter of its
own last frames and from the declared accuracy of its clock. So a sensor with irregular stamps is suspected
only if its stamps run backwards.

While a clock is not understood, its frames are refused: nothing tells when they were measured. This ends when
the clock is as before. It also ends when its frames are steady for a while, and were set back by no more than
a change of exposure or driver explains: by less than a period, and by less than the usual delay.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from rpod_runtime.sensor_data.drift_watch import CLOCK_SIGMAS
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_schemas.messages import NANOSECONDS

_MOST = 64
"""Number of the last frames that show how even a sensor is."""
_LEAST = 10
"""Number of frames from which on this is known, and after which a corrected clock counts as steady."""
_RECENT = 4
"""Number of the last frames with which a frame is compared: some of them may have been delayed."""
_STEADY = 3
"""Number of steps by which ages have to grow one after the other."""
_SCHEDULED, _AWAY = 16, 16
"""Least number of frames that show the schedule of a sensor, and number of the last frames that do not."""
_SIGMAS = 5.0
"""Deviation of a quantity, in its own standard deviations, beyond which it is not as before."""
_HALF = 0.5
"""Share of the deviation of stamps, or of the change of an age, up to which arrivals may deviate likewise."""


class _Frame(NamedTuple):
    stamp_ns: int
    arrival_ns: int
    arrival_s: float
    """Time of arrival, monotonic clock: a jump of this machine's own clock is not one of the sensor's."""

    @property
    def age_s(self) -> float:
        return (self.arrival_ns - self.stamp_ns) / NANOSECONDS

    def stamp_step_s(self, before: "_Frame") -> float:
        return (self.stamp_ns - before.stamp_ns) / NANOSECONDS

    def host_step_s(self, before: "_Frame") -> float:
        wall_s = (self.arrival_ns - before.arrival_ns) / NANOSECONDS
        return wall_s - (self.arrival_s - before.arrival_s)


class Step(NamedTuple):
    """A clock that was set, and is not understood yet."""

    moved_s: float
    """Change of the stamps against the arrivals, s; negative if the clock was set back."""
    jitter_s: float
    """Greatest deviation that the sensor's own jitter explains, s."""
    age_s: float
    """Age of the newest frame on its arrival, s."""

    @property
    def text(self) -> str:
        """Figures and remedy, for the operator."""
        return (
            f"its stamps have moved by {self.moved_s:+.3f} s against their arrival, while the jitter of its "
            f"frames explains {self.jitter_s:.3f} s: its clock was set, or runs wrong; frames are "
            f"{self.age_s:.3f} s old on arrival now; synchronise it by PTP or chrony, which slew and do not "
            "step, then `reset` the estimator to accept the clock as it is"
        )


class _Pace(NamedTuple):
    """How even the frames of a sensor are."""

    period_s: float
    stamp_s: float
    """Greatest deviation of the time between two stamps that is usual, s."""
    arrival_s: float
    """The same for the time between two arrivals, s."""

    def arrives_as_due(self, before: _Frame, frame: _Frame, frames: int) -> bool:
        """Return whether a frame arrives so many periods after another one, as far as its age has changed.

        If it was delayed, its arrival explains most of that change; if its clock was set, its stamp does.
        """
        late_s = frame.arrival_s - before.arrival_s - frames * self.period_s
        return abs(late_s) <= min(self.arrival_s, _HALF * abs(frame.age_s - before.age_s))

    def stamp_is_due(self, before: _Frame, frame: _Frame) -> bool:
        """Return whether there are whole periods between two stamps: frames may be missing."""
        step_s = frame.stamp_step_s(before)
        periods = max(round(step_s / self.period_s), 1)
        return abs(step_s - periods * self.period_s) <= periods * self.stamp_s


@dataclass
class StepWatch:
    """Follows the stamps of one sensor, frame by frame.

    Args:
        clock_sigma_s: standard deviation of the sensor's stamps, as it is declared.
        within_s: time within which its frames usually arrive after their measurement, s.
    """

    clock_sigma_s: float
    within_s: float
    ended: str = ""
    """How the last suspicion ended, for the operator; set only at the frame with which it ended."""
    corrected_s: float = 0.0
    """Change of the stamps against the arrivals, s, that is believed since this frame; 0 at any other one."""
    overtaken: int = 0
    """Number of frames that arrived after newer ones."""
    _source: object = None
    _frames: deque[_Frame] = field(default_factory=lambda: deque(maxlen=_MOST))
    _held: deque[_Frame] = field(default_factory=lambda: deque(maxlen=_LEAST))
    """Last frames since the clock was set."""

    def forget(self) -> None:
        """Accept the clock as it is."""
        self._frames.clear()
        self._held.clear()

    def add(self, stamp_ns: int, arrival_ns: int, *, arrival_s: float, source: object) -> Step | None:
        """Take a frame; return how its clock was set if the frame cannot be used for that.

        Args:
            stamp_ns: stamp, corrected by its source.
            arrival_ns: time of arrival, this machine's clock.
            arrival_s: time of arrival, monotonic clock.
            source: publisher of the frame: a successor has a clock of its own.
        """
        frame = _Frame(stamp_ns, arrival_ns, arrival_s)
        last = self._held[-1] if self._held else self._frames[-1] if self._frames else frame
        if stamp_ns == last.stamp_ns and last is not frame:
            return None  # sent again: it tells nothing about the clock
        if source != self._source or abs(frame.host_step_s(last)) > self._declared_s:
            self.forget()
        self._source, self.ended, self.corrected_s = source, "", 0.0
        if len(self._frames) < _LEAST:
            self._frames.append(frame)
            return None
        if not self._held and self._was_overtaken(frame):
            self.overtaken += 1
            return None
        step = self._step(frame)
        if step is None:
            self.ended = "its stamps are as before again; its frames are used" if self._held else ""
            self._held.clear()
            self._frames.append(frame)
            return None
        self._held.append(frame)
        if not self._is_corrected():
            return step
        self.ended = (
            f"its stamps have moved by {step.moved_s:+.3f} s and are steady again: its clock was corrected, "
            "or its exposure has changed; its frames are used"
        )
        self.corrected_s = step.moved_s
        self._frames = deque(self._held, maxlen=_MOST)
        self._held.clear()
        return None

    @property
    def _declared_s(self) -> float:
        return CLOCK_SIGMAS * self.clock_sigma_s

    def _step(self, frame: _Frame) -> Step | None:
        """Return the step if the clock of a frame is not that of the frames before."""
        ages_s = np.array([each.age_s for each in self._frames])
        usual_s = float(np.median(ages_s))
        limit_s = self._limit_s(ages_s - usual_s)
        off_s = frame.age_s - usual_s
        if abs(off_s) <= limit_s:
            return None
        if not self._held and not self._was_set(frame, off_s, ages_s - usual_s, limit_s):
            return None
        return Step(-off_s, limit_s, frame.age_s)

    def _was_overtaken(self, frame: _Frame) -> bool:
        """Return whether a frame only arrived after newer ones: it fills a gap between their stamps.

        The frames of a clock that was set back go on from their new stamps, and fill no gap.
        """
        stamps = [each.stamp_ns for each in self._frames]
        later = [each for each in stamps[-_RECENT:] if each > frame.stamp_ns]
        earlier = [each for each in stamps if each <= frame.stamp_ns]
        pace = self._pace()
        if not later or not earlier or pace is None:
            return False
        gaps_s = (min(later) - frame.stamp_ns) / NANOSECONDS, (frame.stamp_ns - max(earlier)) / NANOSECONDS
        return all(gap_s >= pace.period_s - pace.stamp_s for gap_s in gaps_s)

    def _was_set(self, frame: _Frame, off_s: float, before_s: FloatArray, limit_s: float) -> bool:
        """Return whether the clock was set, for a frame whose age is off.

        Args:
            frame: the frame.
            off_s: its age over the usual one, s.
            before_s: the same of the frames before it, s.
            limit_s: greatest deviation that the jitter explains, s.
        """
        if frame.stamp_ns < self._frames[-1].stamp_ns and off_s > 0.0:
            return True
        if (pace := self._pace()) is None:
            return False
        is_possible = frame.age_s > -self._declared_s
        for frames in range(1, _RECENT + 1):
            before, earlier = self._frames[-frames], self._frames[-frames - 1]
            is_usual = abs(before_s[-frames]) <= limit_s and pace.stamp_is_due(earlier, before)
            stamp_is_due = is_possible and pace.stamp_is_due(before, frame)
            if is_usual and pace.arrives_as_due(before, frame, frames) and not stamp_is_due:
                return True
        off_s_all = np.array([*before_s, off_s])
        return is_possible and (
            self._drifts(frame, off_s_all, pace, limit_s)
            or self._leaves_its_schedule(frame, off_s_all, pace, limit_s)
        )

    def _drifts(self, frame: _Frame, off_s: FloatArray, pace: _Pace, limit_s: float) -> bool:
        """Return whether the ages of the last frames grow steadily, while they arrive as due.

        This is so if a clock has lost time since a pause, so that none of the frames before is as usual.
        """
        last = [*list(self._frames)[-_STEADY:], frame]
        steps_s = np.diff([each.arrival_s for each in last])
        as_due = bool(np.abs(steps_s - pace.period_s).max() <= pace.arrival_s)
        as_due = as_due and pace.arrives_as_due(last[0], frame, _STEADY)
        grow_s = np.diff(off_s[-_STEADY - 1 :]) * np.sign(off_s[-1])
        grows = bool(grow_s.min() > 0.0 and grow_s.sum() > limit_s)
        return as_due and grows and not pace.stamp_is_due(last[0], frame)

    def _leaves_its_schedule(self, frame: _Frame, off_s: FloatArray, pace: _Pace, limit_s: float) -> bool:
        """Return whether the stamps of the last frames leave their schedule, while arrivals keep theirs.

        A clock that loses a little with each frame may lose less than the jitter of one frame. A delay of
        some frames leaves their stamps as they were due, and a sensor of another rate changes both.
        """
        frames = [*self._frames, frame]
        if len(frames) < _SCHEDULED + _AWAY or np.abs(np.median(off_s[-_RECENT:])) <= limit_s:
            return False
        first = frames[0]
        stamps_s = np.array([each.stamp_step_s(first) for each in frames])
        arrivals_s = np.array([each.arrival_s - first.arrival_s for each in frames])
        periods = np.append(0.0, np.cumsum(np.maximum(np.round(np.diff(stamps_s) / pace.period_s), 1.0)))
        leaving_s, most_stamp_s = self._beside_schedule_s(periods, stamps_s)
        arriving_s, most_arrival_s = self._beside_schedule_s(periods, arrivals_s)
        last_s = float(leaving_s[-1])
        leaves = (
            np.diff(leaving_s * np.sign(last_s)).min() > self._declared_s and abs(last_s) > 2.0 * most_stamp_s
        )
        as_due = np.abs(arriving_s).max() <= min(most_arrival_s, _HALF * abs(last_s))
        half = (len(frames) - _AWAY) // 2
        first_s, second_s, before_s, arrive_s, stamp_s = (
            float(np.median(np.diff(times_s[part]) / np.diff(periods[part])))
            for times_s, part in (
                (stamps_s, slice(half)),
                (stamps_s, slice(half, -_AWAY)),
                (arrivals_s, slice(-_AWAY)),
                (arrivals_s, slice(-_AWAY, None)),
                (stamps_s, slice(-_AWAY, None)),
            )
        )
        has_one_rate = abs(first_s - second_s) < _HALF * abs(stamp_s - before_s)
        keeps_pace = abs(arrive_s - before_s) < abs(arrive_s - stamp_s)
        return bool(leaves and as_due and has_one_rate and keeps_pace)

    def _beside_schedule_s(self, periods: FloatArray, times_s: FloatArray) -> tuple[FloatArray, float]:
        """Return how far the last times are from the schedule of the frames before, and its limit, s.

        The schedule is the line of median slope (P. K. Sen, JASA 63, 1968); ``scipy.stats`` has it too, but
        takes half a second of each start.
        """
        known, known_s = periods[:-_AWAY], times_s[:-_AWAY]
        first, second = np.triu_indices(len(known), 1)
        period_s = np.median((known_s[second] - known_s[first]) / (known[second] - known[first]))
        beside_s = times_s - np.median(known_s) - period_s * (periods - np.median(known))
        blocks_s = np.median(beside_s[-_AWAY:].reshape(-1, _RECENT), axis=1)
        before_s = beside_s[:-_AWAY]
        # a sensor that keeps no schedule, as one that is triggered by hand, wanders away from any
        wanders_s = before_s[_SCHEDULED // 2 :] - before_s[: -_SCHEDULED // 2]
        shown_s = float(np.abs(before_s).max())
        return blocks_s, max(self._limit_s(before_s), self._limit_s(wanders_s), shown_s)

    def _pace(self) -> _Pace | None:
        """Return how even stamps and arrivals are; None where stamps do not rise."""
        stamps_s = np.diff([each.stamp_ns for each in self._frames]) / NANOSECONDS
        arrivals_s, period_s = np.diff([each.arrival_s for each in self._frames]), self._period_s
        if period_s <= 0.0:
            return None
        beside_s = stamps_s - np.maximum(np.round(stamps_s / period_s), 1.0) * period_s
        # late exposures of a busy driver are rare, and the median does not show them
        shown_s = float(np.abs(beside_s[:-_RECENT]).max())
        stamp_s = max(self._limit_s(stamps_s - period_s), shown_s)
        return _Pace(period_s, stamp_s, self._limit_s(arrivals_s - period_s))

    def _limit_s(self, deviations_s: FloatArray) -> float:
        return float(_SIGMAS * MAD_TO_SIGMA * np.median(np.abs(deviations_s)) + self._declared_s)

    def _is_corrected(self) -> bool:
        """Return whether the clock was set once, to a time that is as likely as the one before."""
        if len(self._held) < _LEAST:
            return False
        usual_s = np.array([each.age_s for each in self._frames])
        ages_s = np.array([each.age_s for each in self._held])
        before_s, now_s = float(np.median(usual_s)), float(np.median(ages_s))
        is_steady = np.abs(ages_s - now_s).max() <= self._limit_s(usual_s - before_s)
        if not is_steady or now_s < -self._declared_s:
            return False
        if before_s < -self._declared_s:
            return now_s <= self.within_s  # before, frames had arrived before they were measured
        return now_s - before_s <= min(self._period_s, self.within_s)

    @property
    def _period_s(self) -> float:
        return float(np.median(np.diff([each.stamp_ns for each in self._frames]))) / NANOSECONDS
