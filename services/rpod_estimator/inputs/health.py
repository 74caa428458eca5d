"""Reports to the operator about inputs that are not used: in diagnostics, and each minute in the log."""

import logging

from pydantic import ValidationError

from rpod_estimator.frame_reader import Arrived
from rpod_estimator.inputs.book import (
    JOINING,
    OK,
    OUT_OF_RANGE,
    REJECTED,
    SEARCHING,
    USUAL_LIMITS,
    WINDOW_S,
    InputState,
    Loss,
    SensorBook,
    unpaired,
    unused,
)
from rpod_estimator.inputs.refusals import Refusals
from rpod_pose.belief import AMPLITUDE_LEFT_OUT, NOISE_M, STATED_NOISE_M
from rpod_pose.navigation.state import Cause, Output
from rpod_runtime.assembler import GivenUp
from rpod_runtime.delivery.holders import Peer
from rpod_runtime.health import HealthBook
from rpod_runtime.process.load import busy_machine
from rpod_schemas.config.estimator.estimator import NavigatorTuning
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.texts import without_figures
from rpod_schemas.types import Diagnostic, Health, Mode, SensorSync

log = logging.getLogger(__name__)

REMIND_S = 60.0
"""Time after which a state that is not OK is written to the log again."""
_BRIGHT_BEYOND = (
    "its amplitude is not used, poses come from depth alone: what has no range is as bright as the target; "
    "let the driver publish the ranges of what is behind the target, cover it, or leave the amplitude out of "
    "source.topics"
)
_NOISIER = (
    "its ranges have a noise of {:.2g} m, not of {:.2g} m as stated or assumed; poses have the larger one; "
    "state it as sigma_range_m of lidar/info, or of the sensor in the estimator's configuration"
)
_KIND_OF = {
    Cause.OTHER: REJECTED,
    Cause.OUT_OF_RANGE: OUT_OF_RANGE,
    Cause.JOINING: JOINING,
    Cause.SLOW_SEARCH: SEARCHING,
}
"""Kind of a loss, by the cause that the navigator states."""
_PERIOD_S = 1.0
"""Time between two updates of the diagnostics."""


class InputHealth:
    """Health of all inputs of the estimator.

    Args:
        health: book in which the diagnostics are kept.
        leading: leading part of each sensor's frames, by sensor.
        now_s: time, s, of the monotonic clock, as in all methods.
        silence_s: least time without a frame after which a sensor is silent, s.
        limits: limits by which the navigator begins and ends tracks.
    """

    def __init__(
        self,
        health: HealthBook,
        leading: dict[str, str],
        *,
        now_s: float,
        silence_s: float = WINDOW_S,
        limits: NavigatorTuning = USUAL_LIMITS,
    ) -> None:
        self._health, self._leading = health, leading
        self.books = {
            sensor: SensorBook(sensor, part, now_s=now_s, silence_s=silence_s, limits=limits)
            for sensor, part in leading.items()
        }
        self._reported: dict[str, tuple[InputState, float]] = {}
        self._next_s = now_s
        self._state = OK
        self._pause_s = 0.0
        self._rival_topics: set[str] = set()
        self.refusals = Refusals()
        """Refused messages that are no frames."""
        self.rivals: list[tuple[str, Peer, Peer]] = []
        """Second publishers of a topic: the topic, the publisher that is used, the other one."""

    def judge(self, arrived: Arrived, output: Output, now_s: float) -> None:
        """Note whether a frame was used, and why not."""
        book, status = self.books[arrived.sensor], output.status
        if arrived.refused == Reason.SECOND_PUBLISHER:
            return  # reported as one of two publishers
        if output.paused:
            self._health.count(f"dropped/{arrived.sensor}")
        if output.search and not output.why:  # the result of the search is reported at its own frame
            return
        book.note_repeats(arrived.repeats)
        book.note("defect", arrived.defect)
        book.note("hint", arrived.hint)
        if status.accepted:
            book.use(now_s, output.weak_support)
            if AMPLITUDE_LEFT_OUT in status.evidence:
                book.tell(now_s, _BRIGHT_BEYOND)
            if NOISE_M in status.evidence:
                noises = status.evidence[NOISE_M], status.evidence[STATED_NOISE_M]
                book.tell(now_s, _NOISIER.format(*noises))
        else:
            kind = arrived.refused or _KIND_OF[output.cause]
            book.lose(Loss(kind, output.why), now_s)

    def give_up(self, sensor: str, frame: GivenUp, now_s: float) -> None:
        """Note a frame that never became complete."""
        leading, book = self._leading[sensor], self.books[sensor]
        if leading in frame.parts:
            book.lose(unpaired(frame, leading), now_s)
        else:
            book.note_others(now_s, unused(frame, leading))

    def drop(self, sensor: str, now_s: float) -> None:
        """Count a frame that was not processed, because newer ones arrived while the estimator worked."""
        self._health.count(f"dropped/{sensor}")
        self.books[sensor].drop(now_s)

    def rest(self, pause_s: float) -> None:
        """Note the time between two searches, 0 while they are not limited."""
        self._pause_s = pause_s

    def take_diagnostic(self, diagnostic: Diagnostic) -> None:
        """Use a driver's report about a sensor's clock. Raises ``MessageRejectedError``."""
        for sensor, book in self.books.items():
            try:
                sync = SensorSync.read(sensor, diagnostic.values)
            except ValidationError as error:
                problem = error.errors(include_url=False)[0]
                text = f"sync/{sensor}/{problem['loc'][0]} of {diagnostic.name}: {problem['msg']}"
                raise MessageRejectedError(Reason.MALFORMED, text) from error
            if sync is not None:
                book.note_sync(sync)
                for name, value in sync.values(sensor).items():
                    self._health.set_text(name, value)

    def report(self, mode: Mode, now_s: float, bus_s: float | None = None) -> None:
        """Write level, message and counters into the diagnostics; log what is not used.

        ``bus_s`` is the time of the bus, if that is the time of the stamps, s.
        """
        if now_s >= self._next_s:
            self._next_s = now_s + _PERIOD_S
            self._state = self._update(now_s, bus_s)
        level = max(self._state.level, Health.WARN if mode in (Mode.LOST, Mode.COASTING) else Health.OK)
        self._health.report(level, "; ".join(filter(None, (mode.name.lower(), self._state.text))))

    def _update(self, now_s: float, bus_s: float | None) -> InputState:
        states, busy = [], busy_machine()
        for sensor, book in self.books.items():
            book.note("load", busy)
            self._health.put(f"inputs/{sensor}/used", book.used)
            for kind, frames in book.lost.items():
                self._health.put(f"inputs/{sensor}/not_used/{kind}", frames)
                self._health.set_text(f"input/{sensor}/{kind}", book.examples[kind])
            state = book.state(now_s, bus_s)
            self._log(sensor, state, now_s)
            states.append(state)
        rivals = self._rivals_state()
        self._log("publishers", rivals, now_s)
        states.append(rivals)
        states += self.refusals.states(now_s)  # `Node.reject` has logged each of them
        if self._pause_s:
            states.append(InputState(Health.OK, f"searches are limited: one frame in {self._pause_s:.1f} s"))
        text = "; ".join(state.text for state in states if state.text)
        return InputState(max(state.level for state in states), text)

    def _rivals_state(self) -> InputState:
        for topic in {name for name, *_ in self.rivals}.symmetric_difference(self._rival_topics):
            self._health.set_text(f"publishers/{topic}", "")
        self._rival_topics = {name for name, *_ in self.rivals}
        for topic, used, other in self.rivals:
            self._health.set_text(f"publishers/{topic}", f"{used} is used, {other} is not")
        if not self.rivals:
            return OK
        topic, used, other = self.rivals[0]
        more = f" and {len(self.rivals) - 1} more topics" if len(self.rivals) > 1 else ""
        return InputState(
            Health.WARN,
            f"two publishers on {topic}{more}: {used} is used, {other} is not; stop one of them, or `reset` "
            "with keep_gid of the one to keep",
        )

    def _log(self, name: str, state: InputState, now_s: float) -> None:
        """Write a line when more than the figures of a state change, and each minute while it is not OK."""
        before, reported_s = self._reported.get(name, (OK, now_s))
        is_same = (state.level, without_figures(state.text)) == (before.level, without_figures(before.text))
        if is_same and (state.level == Health.OK or now_s - reported_s < REMIND_S):
            return
        self._reported[name] = state, now_s
        if state.level == Health.OK:
            log.info("%s", state.text or f"{name}: in order again")
        else:
            log.log(logging.ERROR if state.level == Health.ERROR else logging.WARNING, "%s", state.text)
