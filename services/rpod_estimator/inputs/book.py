"""Account of the estimator's inputs: which frames of each sensor were used, and why the others were not.

It knows neither bus nor clock; times are seconds of one monotonic clock. Its memory is bounded.
"""

from collections import Counter, deque
from dataclasses import dataclass
from statistics import median
from typing import Literal, NamedTuple

from rpod_runtime.assembler import GivenUp
from rpod_schemas.config.estimator.estimator import NavigatorTuning
from rpod_schemas.errors import Reason
from rpod_schemas.texts import without_figures
from rpod_schemas.types import Health, SensorSync

WINDOW_S = 2.0
"""Time span of the frames that are checked."""
LEAST_FRAMES = 3
"""Least number of frames that are checked, if fewer arrived in ``WINDOW_S`` from a slow sensor."""
LOCKSTEP_SILENCE_S = 60.0
"""As ``WINDOW_S``, for silence by the wall clock in lockstep, where one second of the scenario may take many
seconds. There the time of the bus decides, unless it stands still because the clock waits for a frame."""
_SILENT_PERIODS = 3.0
"""Number of a sensor's periods after which it is silent, if this is longer than ``WINDOW_S``."""
USUAL_LIMITS = NavigatorTuning()
"""Limits by which a navigator begins and ends tracks if its configuration has none."""
AT_ONCE = frozenset({Reason.OTHER_SETUP, Reason.OTHER_CAMERA, Reason.CLOCK_STEP})
"""Kinds of losses that are reported at the first frame: the sensor or its clock has changed."""
UNPAIRED, REJECTED, SEARCHING = "unpaired", "rejected", "searching"
"""Kinds of losses beside those of ``Reason``: parts of a frame are missing; the estimator rejected it; it
came during a search that takes long, which is no error."""
OUT_OF_RANGE, JOINING = "out_of_range", "joining"
"""Kinds of losses of a sensor in order that waits: until the target is within its range; until other sensors
confirm it."""
_JOINS_S = 10.0
"""Time for which a sensor may wait until others confirm it, s: two scans of a LIDAR at 0.2 Hz. If it takes
longer, they do not agree."""
Note = Literal["clock", "drift", "defect", "hint", "load", "instead"]
"""What a text about a sensor is: how its stamps and the arrival of its frames contradict each other; how its
clock drifts, if more than is declared; the defect of its newest frame, which is used nevertheless; a fault in
its newest frames that may be why they are refused; how busy this machine is, if other processes may be why
frames wait; the awaited topic of a sensor that has never sent, and what is published instead."""
_CHECK = (
    "'rpod driver check {}' looks for errors of the sensor, with --target and --search also for a mirrored "
    "image, another unit or lens; if the sensor is right, the target's file may differ from the body: 'rpod "
    "target check' draws it"
)


class Loss(NamedTuple):
    """Why a frame was not used."""

    kind: str
    """A ``Reason``, ``UNPAIRED``, ``REJECTED``, ``SEARCHING``, ``OUT_OF_RANGE`` or ``JOINING``."""
    text: str
    """Reason with its figures and the remedy."""


class InputState(NamedTuple):
    """Health of an input."""

    level: Health
    text: str
    """Description for the operator with figures and remedy; empty if there is nothing to report."""


OK = InputState(Health.OK, "")


@dataclass(frozen=True, slots=True)
class _Frame:
    time_s: float
    loss: Loss | None
    weak_support: str = ""


class SensorBook:
    """Account of one sensor's frames.

    Args:
        name: name of the sensor.
        leading: part by which its frames are counted.
        now_s: time, s, of the monotonic clock, as in all methods.
        silence_s: least time without a frame after which the sensor is silent, s.
        limits: limits by which the navigator begins and ends tracks.
    """

    def __init__(
        self,
        name: str,
        leading: str,
        *,
        now_s: float,
        silence_s: float = WINDOW_S,
        limits: NavigatorTuning = USUAL_LIMITS,
    ) -> None:
        self.name, self._leading, self._silence_s, self._limits = name, leading, silence_s, limits
        self.used = 0
        """Number of frames whose measurement was accepted."""
        self.lost: Counter[str] = Counter()
        """Number of frames that were not used, by kind of loss."""
        self.examples: dict[str, str] = {}
        """Last loss of each kind, in words."""
        self._joins_since_s: float | None = None
        self._repeats = 0
        self._sync = SensorSync()
        self._notes: dict[Note, str] = {}
        self._recent: deque[_Frame] = deque(maxlen=1024)
        self._dropped_s: deque[float] = deque(maxlen=1024)
        self._gaps_s: deque[float] = deque(maxlen=9)
        self._heard_s: float | None = None
        self._since_s = now_s
        self._others_s = -WINDOW_S
        self._bus_heard_s: float | None = None
        self._bus_gaps_s: deque[float] = deque(maxlen=9)
        self._told: deque[tuple[float, str]] = deque(maxlen=1024)

    @property
    def is_unheard(self) -> bool:
        """Whether no frame of it has arrived yet."""
        return self._heard_s is None

    def note_arrival(self, now_s: float, bus_s: float | None = None) -> None:
        """Note that the leading part of a frame arrived.

        ``bus_s`` is its stamp, s, if time comes from the bus; otherwise None.
        """
        if bus_s is not None:
            if self._bus_heard_s is not None:
                self._bus_gaps_s.append(max(bus_s - self._bus_heard_s, 0.0))
            self._bus_heard_s = bus_s
        if self._heard_s is None or now_s - self._heard_s > self._silent_after_s:
            self._since_s = now_s
            self._recent.clear()
        if self._heard_s is not None:
            self._gaps_s.append(max(now_s - self._heard_s, 0.0))
        self._heard_s = now_s

    def use(self, now_s: float, weak_support: str = "") -> None:
        """Count a frame that was used; ``weak_support`` is why it supports its pose only weakly, if so."""
        self.used += 1
        self._joins_since_s = None
        self._recent.append(_Frame(now_s, None, weak_support))

    def lose(self, loss: Loss, now_s: float) -> None:
        """Count a frame that was not used."""
        self.lost[loss.kind] += 1
        self.examples[loss.kind] = loss.text
        if loss.kind == JOINING and self._joins_since_s is None:
            self._joins_since_s = now_s
        self._recent.append(_Frame(now_s, loss))

    def tell(self, now_s: float, text: str) -> None:
        """Note what the operator must know of a frame that was used, such as a part that is left out."""
        self._told.append((now_s, text))

    def drop(self, now_s: float) -> None:
        """Note a frame that was not processed, because newer ones arrived while the estimator worked."""
        self._dropped_s.append(now_s)

    def note(self, about: Note, text: str) -> None:
        """Keep a text for the reports about the sensor, in place of the one before; empty for none."""
        self._notes[about] = text

    def note_repeats(self, repeats: int) -> None:
        """Note how many of its newest frames are identical to the one before them."""
        self._repeats = repeats

    def note_sync(self, sync: SensorSync) -> None:
        """Note how the sensor keeps time, by its driver."""
        self._sync = sync

    def note_others(self, now_s: float, unused: str = "") -> None:
        """Note that parts of a frame arrived without the leading one.

        ``unused`` is the reason why no frame uses them; empty if they are only late.
        """
        self._others_s = now_s
        if unused:
            self._told.append((now_s, unused))

    @property
    def _silent_after_s(self) -> float:
        return max(self._silence_s, _SILENT_PERIODS * median(self._gaps_s or [0.0]))

    def state(self, now_s: float, bus_s: float | None = None) -> InputState:
        """Return the health: WARN if more than half of the recent frames were not used, ERROR if none was.

        ``bus_s`` is the time of the bus, if that is the time of the stamps, s; None before its first message.
        """
        others = now_s - self._others_s <= WINDOW_S
        if (silent_s := self._bus_silent_s(bus_s)) > 0.0:
            text = self._silence(silent_s, " of bus time", others=others)
            return InputState(Health.WARN, f"{self.name}: {text}")
        heard_s = self._since_s if self._heard_s is None else self._heard_s
        judged_s = self._recent[-1].time_s if self._recent else heard_s  # a frame may take a minute itself
        silent_s = now_s - max(heard_s, judged_s)
        if silent_s > self._silent_after_s:
            return InputState(Health.WARN, f"{self.name}: {self._silence(silent_s, others=others)}")
        while len(self._recent) > LEAST_FRAMES and now_s - self._recent[0].time_s > WINDOW_S:
            self._recent.popleft()
        newest = self._recent[-1].loss if self._recent else None
        if newest is not None and newest.kind in AT_ONCE:
            return InputState(Health.ERROR, f"{self.name}: {newest.text}")
        losses = [frame.loss for frame in self._recent if frame.loss is not None]
        waiting = [loss for loss in losses if self._is_waiting(loss, now_s)]
        if 2 * len(waiting) > len(self._recent):
            return self._waits(waiting[-1])
        losses = [loss for loss in losses if not self._is_waiting(loss, now_s)]
        frames = len(self._recent) - len(waiting)
        if frames < LEAST_FRAMES or now_s - self._since_s < WINDOW_S or 2 * len(losses) <= frames:
            return self._doubtful(now_s)
        (reason, most), *_ = Counter(without_figures(loss.text) for loss in losses).most_common(1)
        latest = next(loss for loss in reversed(losses) if without_figures(loss.text) == reason)
        how = "no frame" if len(losses) == frames else f"only {frames - len(losses)} of {frames} frames"
        level = Health.ERROR if len(losses) == frames and latest.kind != SEARCHING else Health.WARN
        past_s = now_s - self._recent[0].time_s
        check = _CHECK.format(self.name) if latest.kind in (REJECTED, SEARCHING, JOINING) else ""
        hint = self._noted("hint") if latest.kind == REJECTED else ""
        load = self._overloaded(now_s) or (self._noted("load") if latest.kind == SEARCHING else "")
        text = _joined(latest.text, self._noted("clock", "drift", "defect"), hint, load, check)
        return InputState(level, f"{self.name}: {how} used in {past_s:.1f} s; {most} of {frames}: {text}")

    def _is_waiting(self, loss: Loss, now_s: float) -> bool:
        since_s = now_s if self._joins_since_s is None else self._joins_since_s
        return loss.kind == OUT_OF_RANGE or (loss.kind == JOINING and now_s - since_s <= _JOINS_S)

    def _waits(self, waiting: Loss) -> InputState:
        """Return the health of a sensor in order that waits, of which only the clock is judged."""
        clock = self._noted("clock", "drift")
        text = _joined(f"{waiting.text}; its frames are not used meanwhile", clock)
        return InputState(Health.WARN if clock else Health.OK, f"{self.name}: {text}")

    def _bus_silent_s(self, bus_s: float | None) -> float:
        """Return for how long the sensor is silent by the time of the bus, s; 0 if it is not."""
        if bus_s is None:
            return 0.0
        if self._bus_heard_s is None:
            self._bus_heard_s = bus_s  # silence is counted from the first message of the clock
        silent_s = bus_s - self._bus_heard_s
        return (
            silent_s if silent_s > max(WINDOW_S, _SILENT_PERIODS * median(self._bus_gaps_s or [0.0])) else 0.0
        )

    def _doubtful(self, now_s: float) -> InputState:
        if self._sync.ptp == "unlocked":
            offset_s = self._sync.ptp_offset_s
            offset = "" if offset_s is None else f", it is {offset_s:.6f} s off"
            return InputState(
                Health.WARN, f"{self.name}: its clock is not locked to PTP{offset}; look at ptp4l"
            )
        if known := _joined(self._noted("clock", "drift", "defect"), self._overloaded(now_s)):
            return InputState(Health.WARN, f"{self.name}: {known}")
        told = [text for time_s, text in self._told if now_s - time_s <= WINDOW_S]
        if len(told) >= LEAST_FRAMES and 2 * len(told) > len(self._recent):
            return InputState(Health.WARN, f"{self.name}: {told[-1]}")
        weak = [frame.weak_support for frame in self._recent if frame.weak_support]
        begins, ends = self._limits.max_beginning_share, self._limits.max_contradicted_share
        if len(weak) > max(1.0, begins * len(self._recent)):
            return InputState(
                Health.WARN,
                f"{self.name}: {len(weak)} of {len(self._recent)} frames support the pose too little: "
                f"{weak[-1]}; a track ends if more than {100.0 * ends:g}% of the frames are such, and none "
                f"begins above {100.0 * begins:g}%; compare model and target (shape, materials), and check "
                "lens and exposure",
            )
        if self._repeats < LEAST_FRAMES:
            return OK
        text = (
            f"{self.name}: its last {self._repeats + 1} frames are identical to the bit; restart its driver"
        )
        return InputState(Health.WARN, text)

    def _overloaded(self, now_s: float) -> str:
        """Return the report, with the remedy, if more than half of the recent frames were dropped."""
        dropped = sum(now_s - time_s <= WINDOW_S for time_s in tuple(self._dropped_s))
        processed = sum(now_s - frame.time_s <= WINDOW_S for frame in self._recent)
        if dropped < LEAST_FRAMES or dropped <= processed:
            return ""
        load = self._noted("load")
        remedy = ("end other work, or " if load else "") + "lower the sensor's rate or its image size"
        text = f"{dropped} of {dropped + processed} frames dropped: they come faster than they are processed"
        return _joined(text, load, remedy)

    def _noted(self, *about: Note) -> str:
        return _joined(*(self._notes.get(each, "") for each in about))

    def _silence(self, silent_s: float, of_time: str = "", *, others: bool) -> str:
        time = f"{silent_s:.0f} s{of_time}"
        if others:
            return f"no {self._leading} for {time}, only other parts of its frames; look at its driver"
        if self._heard_s is None:
            return f"no frame yet in {time}; {self._noted('instead') or 'is its driver running?'}"
        return f"no frame for {time}; look at its driver, and at the link to it"


def unpaired(frame: GivenUp, leading: str) -> Loss:
    """Return why an incomplete frame was not used."""
    if not frame.lacks:
        return Loss(UNPAIRED, f"its {leading} came after that of a newer frame; look at the network")
    lacks = " and ".join(_lack(part, step_ns) for part, step_ns in frame.lacks.items())
    return Loss(UNPAIRED, f"{leading} without {lacks}")


def unused(frame: GivenUp, leading: str) -> str:
    """Return why parts without a leading one belong to no frame; empty if they are only late."""
    step_ns = frame.lacks.get(leading)
    if not step_ns:
        return ""
    parts = sorted(frame.parts)
    are = "is" if len(parts) == 1 else "are"
    return f"{' and '.join(parts)} {are} not used without {_lack(leading, step_ns)}"


def _joined(*texts: str) -> str:
    return "; ".join(filter(None, texts))


def _lack(part: str, step_ns: int | None) -> str:
    if step_ns is None:
        return f"{part}, which does not come at all: let the driver publish it"
    when = "later" if step_ns > 0 else "earlier"
    return (
        f"{part}: the nearest one is stamped {abs(step_ns) * 1e-6:.3f} ms {when}; give all parts of a frame "
        "the same stamp, or set source.pair_within_s of the sensor"
    )
