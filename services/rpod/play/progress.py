"""Progress of a run for the operator: scenario time, frame rates, state, current error.

It subscribes to ``tf`` at 25 Hz, the statuses and the diagnostics, which takes very little of the processor's
time.
"""

import time
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from scipy.spatial.transform import RigidTransform

from rpod_runtime import Inbox, Node, Received
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import NANOSECONDS, read_diagnostics, read_status, read_transforms
from rpod_schemas.poses import between
from rpod_schemas.texts import is_count, shown
from rpod_schemas.topics import DIAGNOSTICS, STATUS, TARGET, TARGET_ESTIMATE, TF
from rpod_schemas.types import Diagnostic, Health, Mode
from rpod_target import NO_SYMMETRY, load_equivalence

_STYLES = {
    Mode.TRACKING: "green",
    Mode.VERIFYING: "yellow",
    Mode.ACQUIRING: "yellow",
    Mode.LOST: "red",
    Mode.COASTING: "magenta",
}
_LEVELS = {Health.WARN: "yellow", Health.ERROR: "red"}
_PLAIN_PERIOD_S = 5.0
_MOST = 100
"""Largest number of services in trouble, of sensors, and of lines that stay: anybody may send diagnostics."""
_VIEW = ViewConfig.model_fields["instance"].default


@dataclass
class _Seen:
    """The latest messages of the services."""

    truth: deque[tuple[int, RigidTransform]] = field(default_factory=lambda: deque(maxlen=50))
    first_truth_ns: int | None = None
    mode: Mode | None = None
    frames: int = 0
    accepted: int = 0
    attitude_deg: float = float("nan")
    position_m: float = float("nan")
    rates_hz: dict[str, float] = field(default_factory=dict)
    counted: dict[str, tuple[int, int]] = field(default_factory=dict)
    troubles: dict[str, Diagnostic] = field(default_factory=dict)
    """Last diagnostic of each service whose level is not OK."""


class Progress:
    """The progress of a run: a line that is redrawn on a terminal, elsewhere a new line every few seconds."""

    def __init__(self, *, quiet: bool) -> None:
        self._console = Console(markup=False, stderr=True, quiet=quiet)
        self._live: Live | None = None
        self._seen = _Seen()
        self._inbox = Inbox()
        self._scenario: Scenario | None = None
        self._alike = NO_SYMMETRY
        self._rate_unit = "Hz"
        self._said = ""
        self._printed: set[str] = set()
        self._plain_s = 0.0

    def __enter__(self) -> "Progress":
        if self._console.is_terminal and not self._console.quiet:
            self._live = Live(console=self._console, refresh_per_second=8, transient=True)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.stop()

    @property
    def is_shown(self) -> bool:
        """Whether anything is printed."""
        return not self._console.quiet

    def say(self, text: str) -> None:
        """Print a message about the run."""
        if text == self._said:
            return
        self._said = text
        if self._live:
            self._live.update(Text(f"  {text} ...", style="dim"))
        else:
            self._console.print(f"{text} ...", style="dim")

    def note(self, text: str) -> None:
        """Print a message on a line that stays; a message is printed once."""
        if text not in self._printed and len(self._printed) < _MOST:
            self._printed.add(text)
            self._console.print(text, soft_wrap=True, highlight=False)

    def watch(self, node: Node, scenario: Scenario, *, lockstep: bool = False) -> None:
        """Subscribe to the messages of a run; in lockstep, rates by the wall clock are not the sensors'."""
        self._scenario, self._alike = scenario, load_equivalence(scenario.target)
        self._rate_unit = "frames a second of real time" if lockstep else "Hz"
        for topic in (TF, STATUS, DIAGNOSTICS):
            node.subscribe(topic, self._inbox.put)

    def update(self) -> None:
        """Process the messages received since the last call, and show them."""
        for received in self._inbox.wait(0.0):
            try:
                self._take(received)
            except MessageRejectedError:  # the logger and the estimator count it
                continue
        if self._live:
            self._live.update(self._screen())
        elif time.monotonic() - self._plain_s > _PLAIN_PERIOD_S:
            self._plain_s = time.monotonic()
            line = "  ".join(text.plain for text in self._cells())
            self._console.print(line.rstrip(), soft_wrap=True, highlight=False)
            for text in self._problems():
                self._console.print(text, soft_wrap=True, highlight=False)

    def _take(self, received: Received) -> None:
        message = received.decode()
        if received.topic == TF:
            for stamp_ns, _, child, pose in read_transforms(message):
                self._take_transform(stamp_ns, child, pose)
        elif received.topic == STATUS:
            status = read_status(message)
            self._seen.mode = status.mode
            self._seen.frames += 1
            self._seen.accepted += status.accepted
        else:
            for diagnostic in read_diagnostics(message):
                if diagnostic.name == _VIEW:
                    self.note(f"view: {shown(diagnostic.message)}")  # such as the address of its page
                self._seen.troubles.pop(diagnostic.name, None)
                if diagnostic.level != Health.OK and len(self._seen.troubles) < _MOST:
                    self._seen.troubles[diagnostic.name] = diagnostic
                self._take_counters(diagnostic.stamp_ns, diagnostic.values)

    def _take_transform(self, stamp_ns: int, child: str, pose: RigidTransform) -> None:
        seen = self._seen
        if child == TARGET:
            seen.first_truth_ns = seen.first_truth_ns or stamp_ns
            seen.truth.append((stamp_ns, pose))
        elif child == TARGET_ESTIMATE:
            truth = self._truth_at(stamp_ns)
            if truth is not None:
                seen.attitude_deg, seen.position_m = self._alike.error_of(pose, truth)

    def _truth_at(self, stamp_ns: int) -> RigidTransform | None:
        samples = list(self._seen.truth)
        for (first_ns, first), (second_ns, second) in pairwise(samples):
            if first_ns <= stamp_ns <= second_ns:  # two may have one stamp, where somebody else publishes too
                return between(first, second, (stamp_ns - first_ns) / max(second_ns - first_ns, 1))
        return None

    def _take_counters(self, stamp_ns: int, values: dict[str, str]) -> None:
        for name, value in values.items():
            if not name.startswith("frames/") or not is_count(value):
                continue
            sensor, count = name.removeprefix("frames/"), int(value)
            if sensor not in self._seen.counted and len(self._seen.counted) >= _MOST:
                continue
            before_ns, before = self._seen.counted.get(sensor, (stamp_ns, count))
            if stamp_ns > before_ns:
                self._seen.rates_hz[sensor] = (count - before) * NANOSECONDS / (stamp_ns - before_ns)
            self._seen.counted[sensor] = stamp_ns, count

    def _cells(self) -> list[Text]:
        seen, scenario = self._seen, self._scenario
        elapsed_s = (seen.truth[-1][0] - (seen.first_truth_ns or 0)) / NANOSECONDS if seen.truth else 0.0
        duration_s = scenario.duration_s if scenario else 0.0
        mode = seen.mode.name if seen.mode is not None else "-"
        rates = (
            "  ".join(f"{sensor} {rate:.1f} {self._rate_unit}" for sensor, rate in seen.rates_hz.items())
            or "no frames yet"
        )
        return [
            Text(f"{min(elapsed_s, duration_s):5.1f} / {duration_s:g} s"),
            Text(rates),
            Text(f"{mode:9}", style=_STYLES.get(seen.mode, "dim") if seen.mode is not None else "dim"),
            Text(f"{seen.accepted}/{seen.frames} accepted"),
            Text(self._error()),
        ]

    def _error(self) -> str:
        """Return the error of the newest estimate; nothing before the first one."""
        seen = self._seen
        if not np.isfinite(seen.position_m):
            return ""
        return f"error {seen.attitude_deg:.2f} deg  {1e3 * seen.position_m:.0f} mm"

    def _problems(self) -> list[Text]:
        return [
            Text(
                f"{each.level.name} {shown(f'{each.name}: {each.message}')}",
                style=_LEVELS.get(each.level, "yellow"),
            )
            for each in self._seen.troubles.values()
        ]

    def _screen(self) -> Group:
        grid = Table.grid(padding=(0, 2))
        grid.add_row(*self._cells())
        return Group(grid, *self._problems())
