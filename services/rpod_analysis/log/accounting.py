"""Counts of messages (published, in the log, missed), and the services' own counters."""

from collections import Counter, defaultdict
from dataclasses import dataclass, field

from rpod_analysis.log.logged import Logged
from rpod_analysis.log.numbering import Numbering
from rpod_schemas.summary import BodyAccount, FrameCount, InputAccount, LostFrames
from rpod_schemas.texts import is_count, without_figures
from rpod_schemas.types import PUBLISHED, Diagnostic, Health

_DROPPED = "dropped"
_INCOMPLETE = "incomplete"
_PASSED_OVER = (f"{_DROPPED}/", f"{_INCOMPLETE}/")
"""Counters of each sensor: complete frames that a newer one replaced, and frames that were never complete."""
_COMMANDS = "commands/"
_INPUTS, _LOSS = "inputs/", "input/"
"""Counters of the frames of each sensor that an estimator used or did not use, and texts with the reasons."""
_BODIES, _BODY = "bodies/", "body/"
"""Counters of the frames of each sensor by what they show of each known body, and texts about bodies
elsewhere."""
_MOST_LOSSES = 500
_MOST_COMMANDS = 12
_MOST_COUNTERS = 100_000
"""Largest number of counters that are kept, of all services; a service has 3,000."""
_MOST_ALARMS = 100
"""Largest number of kinds of alarms that are counted separately."""


@dataclass(frozen=True)
class Command:
    """A command that a service accepted."""

    stamp_ns: int
    service: str
    verb: str
    request: str
    """The request as JSON."""


@dataclass(frozen=True)
class SensorFlow:
    """Number of a sensor's frames by their outcome at the estimator."""

    sensor: str
    published: int
    accepted: int
    rejected: int
    dropped: int
    """Number of complete frames that a newer one replaced before they were processed."""
    incomplete: int
    """Number of frames that were not complete when a newer one was."""

    @property
    def rest(self) -> int:
        """Number of frames without an outcome: the estimator did not run, or they were lost on the bus."""
        with_outcome = self.accepted + self.rejected + self.dropped + self.incomplete
        return max(self.published - with_outcome, 0)


@dataclass
class Account:
    """Counts of a log's messages, and the services' diagnostics, in the order of arrival."""

    logged: Counter[str] = field(default_factory=Counter)
    numbering: Numbering = field(default_factory=Numbering)
    counters: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    """Last value of every counter, by service; the counts before and after a restart are added."""
    alarms: Counter[str] = field(default_factory=Counter)
    """Number of diagnostics of level ERROR, by service and text; the first kinds only."""
    commands: list[Command] = field(default_factory=list)
    """Commands that services accepted, the first ones only."""
    command_count: int = 0
    losses: dict[tuple[str, str, str], str] = field(default_factory=dict)
    """Last text about frames that a service did not use, by service, sensor and kind, and about known bodies,
    by service, ``body``, and body and sensor; the first ones only."""
    _lives: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    _counted: int = 0

    def take(self, logged: Logged) -> None:
        """Count a message."""
        self.logged[logged.topic] += 1
        self.numbering.take(logged)

    def take_diagnostic(self, diagnostic: Diagnostic) -> None:
        """Add a service's counters, and its alarm if the level is ERROR."""
        if diagnostic.level == Health.ERROR:
            alarm = without_figures(f"{diagnostic.name}: {diagnostic.message}")
            known = alarm in self.alarms or len(self.alarms) < _MOST_ALARMS
            self.alarms[alarm if known else "other errors"] += 1
        for name, text in diagnostic.values.items():
            if is_count(text):
                self._take_counter(diagnostic, name, int(text))
            elif name.startswith(_LOSS):
                self._take_loss(diagnostic.name, name.removeprefix(_LOSS), text)
            elif name.startswith(_BODY):
                self._take_loss(diagnostic.name, name, text)

    def _take_counter(self, diagnostic: Diagnostic, name: str, value: int) -> None:
        service = diagnostic.name
        if service not in self.counters or name not in self.counters[service]:
            if self._counted >= _MOST_COUNTERS:
                return
            self._counted += 1
        now, ended = self.counters[service], self._lives[service]
        if value + ended[name] < now[name]:
            ended[name] = now[name]
        if name.startswith(_COMMANDS) and value + ended[name] > now[name]:
            self._take_command(diagnostic, name.removeprefix(_COMMANDS))
        now[name] = value + ended[name]

    def _take_loss(self, service: str, name: str, text: str) -> None:
        first, _, rest = name.partition("/")
        loss = service, first, rest
        if loss in self.losses or len(self.losses) < _MOST_LOSSES:
            self.losses[loss] = text

    def _take_command(self, diagnostic: Diagnostic, verb: str) -> None:
        self.command_count += 1
        if len(self.commands) < _MOST_COMMANDS:
            request = diagnostic.values.get(f"command/{verb}", "")
            self.commands.append(Command(diagnostic.stamp_ns, diagnostic.name, verb, request))

    def frames(self) -> dict[str, FrameCount]:
        """Return the counts of every topic in the log.

        The number of published messages is that of the publishers' counters, or that of their sequence
        numbers if these say more, as where a publisher was killed after it had last told its counters. What
        was published before the log began does not count.
        """
        counts: dict[str, FrameCount] = {}
        for topic, logged in sorted(self.logged.items()):
            counted = sum(counters[PUBLISHED + topic] for counters in self.counters.values())
            at_least = max(counted, self.numbering.published(topic))
            published = max(at_least - self.numbering.before(topic), logged)
            counts[topic] = FrameCount(published=published, logged=logged, missed=published - logged)
        return counts

    def dropped(self, status_topic: str) -> int:
        """Return the number of frames that the estimator that publishes this status dropped."""
        total = 0
        for counters in self.counters.values():
            if PUBLISHED + status_topic in counters:
                by_sensor = [value for name, value in counters.items() if name.startswith(_PASSED_OVER)]
                total += sum(by_sensor) if by_sensor else counters[_DROPPED]
        return total

    def inputs(self, status_topic: str) -> dict[str, InputAccount]:
        """Return the outcomes of each sensor's frames at the estimator that publishes this status."""
        found: dict[str, InputAccount] = {}
        for service, counters in self.counters.items():
            if PUBLISHED + status_topic not in counters:
                continue
            for name, count in counters.items():
                if not name.startswith(_INPUTS):
                    continue
                sensor, outcome, *kind = name.removeprefix(_INPUTS).split("/", 2)
                account = found.setdefault(sensor, InputAccount(used=0, not_used={}))
                if kind:
                    text = self.losses.get((service, sensor, kind[0]), "")
                    account.not_used[kind[0]] = LostFrames(frames=count, last=text)
                elif outcome == "used":
                    found[sensor] = account.model_copy(update={"used": count})
        return found

    def bodies(self, status_topic: str) -> dict[str, dict[str, BodyAccount]]:
        """Return what the frames of each sensor show of known bodies, by the estimator of this status."""
        found: dict[str, dict[str, BodyAccount]] = {}
        for service, counters in self.counters.items():
            if PUBLISHED + status_topic not in counters:
                continue
            for name, frames in counters.items():
                body, _, rest = name.removeprefix(_BODIES).partition("/")
                sensor, _, state = rest.partition("/")
                if not name.startswith(_BODIES) or state not in BodyAccount.model_fields:
                    continue
                last = self.losses.get((service, _BODY[:-1], f"{body}/{sensor}"), "")
                before = found.setdefault(body, {}).get(sensor, BodyAccount(last=last))
                found[body][sensor] = before.model_copy(update={state: frames})
        return found

    def passed_over(self, status_topic: str, sensor: str) -> tuple[int, int]:
        """Return the numbers of a sensor's dropped and incomplete frames at the estimator of this status."""
        mine = [counters for counters in self.counters.values() if PUBLISHED + status_topic in counters]
        dropped, incomplete = (
            sum(counters[f"{kind}/{sensor}"] for counters in mine) for kind in (_DROPPED, _INCOMPLETE)
        )
        return dropped, incomplete
