"""``rpod view`` of a log, from its arguments to its exit code."""

import logging
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from threading import Event
from typing import Any

from rpod.errors import failed
from rpod.options import check_part
from rpod_analysis import AnalysisError, Log, open_log
from rpod_analysis.log.targets import logged_targets
from rpod_analysis.replay.log_view import Part, show_log
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK
from rpod_runtime.process.lifecycle import run as run_service
from rpod_schemas.config.base import check, read_document
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.rmw.cdr import NANOSECONDS
from rpod_target import Target, TargetError, load_target
from rpod_view.view import View
from rpod_view.viewer.viewer import Viewer, open_viewer

log = logging.getLogger(__name__)

_LOG_MEMORY_BYTES = 4_000_000_000
_POLL_S = 0.2


def view_log(
    logs: Sequence[Path], *, config: Path | None, changes: dict[str, Any], start_s: float, end_s: float | None
) -> int:
    """Show a log until the viewer is closed, or write it as a recording; return the exit code."""
    try:
        document = {"memory_bytes": _LOG_MEMORY_BYTES} | (read_document(config) if config else {}) | changes
        checked = check(ViewConfig, document, source=config or "rpod view")
        check_part(start_s, end_s)
        opened = open_log(*logs)
    except (ConfigurationError, AnalysisError) as error:
        return failed("view", error)
    outcome = EXIT_OK

    def serve(stop: Event) -> None:
        nonlocal outcome
        part = Part(
            opened.start_ns + round(start_s * NANOSECONDS),
            None if end_s is None else opened.start_ns + round(end_s * NANOSECONDS),
        )
        try:
            _show(opened, checked, part, stop)
        except AnalysisError as error:
            log.error("%s", error)
            outcome = EXIT_FAILURE

    with opened:
        return run_service("view", serve) or outcome


def _show(opened: Log, config: ViewConfig, part: Part, stop: Event) -> None:
    target = _target(opened, config.target)
    with open_viewer(config, stop) as viewer:
        log.info("%s %s", viewer.how, viewer.where)
        refused: Counter[str] = Counter()
        view = View(
            viewer.recording,
            target=target,
            prefix=config.prefix,
            reject=lambda topic, _: refused.update([topic]),
        )
        show_log(
            opened,
            view,
            prefix=config.prefix,
            rate_hz=config.rate_hz,
            part=part,
            drawn=lambda: _await_taken(viewer, stop),
        )
        for topic, count in refused.items():
            log.warning("%d messages of %s could not be used", count, topic)
        for kind in opened.unreadable.kinds:
            log.warning(
                "%d messages of %s cannot be read (%s): %s", kind.count, kind.topic, kind.reason, kind.example
            )
        while viewer.process is not None and not viewer.closed and not stop.wait(_POLL_S):
            pass


def _await_taken(viewer: Viewer, stop: Event) -> bool:
    """Wait until the viewer has received the drawing; return False if it was closed."""
    while not (stop.is_set() or viewer.closed):
        if viewer.has_taken(_POLL_S):
            return True
    return False


def _target(opened: Log, name: str | None) -> Target | None:
    """Return the target of the command line, or the one in the configurations in the log."""
    chosen = name or logged_targets(opened).shown
    if chosen is None:
        return None
    try:
        return load_target(chosen)
    except TargetError as error:
        if name:
            raise ConfigurationError("--target", "", str(error)) from error
        log.warning("the target's mesh is not shown: %s", error)
        return None
