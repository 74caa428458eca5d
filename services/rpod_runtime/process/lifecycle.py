"""Runs a service as a process: log lines, signals and exit codes.

The first SIGINT or SIGTERM lets the service drain and finish, the second forces the exit. A supervised
process also ends when its supervisor has ended.
"""

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable

from rpod_runtime.errors import BusError, NoRouterError, NotNeededError
from rpod_runtime.process import reserve
from rpod_runtime.process.notify import manager
from rpod_schemas.errors import ConfigurationError
from rpod_security.errors import SecurityError

log = logging.getLogger(__name__)

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
EXIT_OK, EXIT_FAILURE, EXIT_USAGE = 0, 1, 2
SUPERVISED = "RPOD_SUPERVISED"
"""Environment variable that a supervisor sets; the supervisor holds the other end of standard input."""


class Stop(threading.Event):
    """The event that asks a service to stop."""

    orphaned = False
    """Whether it was set because the supervisor had ended without stopping the service."""


def configure_logging(instance: str, level: int = logging.INFO) -> None:
    """Send log lines to standard error, each with time, level, instance and message."""
    logging.basicConfig(
        level=level,
        stream=sys.stderr,
        format=f"%(asctime)s %(levelname)-7s {instance}: %(message)s",
        force=True,
    )


def run(
    instance: str,
    body: Callable[[threading.Event], None],
    *,
    log_level: str = "info",
    reload: Callable[[], object] | None = None,
) -> int:
    """Run a service's body until it returns or is stopped; return the exit code.

    The body receives the event that asks it to stop. An exception that it raises is logged here, once.
    ``reload`` is called at each SIGHUP, in another thread than the body; without it SIGHUP changes nothing.
    """
    configure_logging(instance, logging.getLevelNamesMapping()[log_level.upper()])
    stop = Stop()
    _handle_signals(stop, reload)
    if os.environ.get(SUPERVISED):
        threading.Thread(target=_stop_with_supervisor, args=(stop,), daemon=True).start()
    try:
        body(stop)
    except ConfigurationError as error:
        log.error("%s", error)
        return EXIT_USAGE
    except NotNeededError as error:
        log.info("%s", error)
        return EXIT_OK
    except NoRouterError as error:
        stopped = stop.is_set()  # a stop while it waits is no failure
        log.log(logging.INFO if stopped else logging.ERROR, "%s", error)
        return EXIT_OK if stopped else EXIT_FAILURE
    except (BusError, SecurityError) as error:
        log.error("%s", error)
        return EXIT_FAILURE
    except Exception:
        log.exception("failed")
        return EXIT_FAILURE
    log.info("stopped")
    return EXIT_OK


def _handle_signals(stop: threading.Event, reload: Callable[[], object] | None) -> None:
    """Handle signals in a thread of their own.

    A signal handler that set the event itself would hang if the main thread held the event's lock. The thread
    also lets the second signal end a process whose main thread runs compiled code.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer)
    for each in (*_SIGNALS, signal.SIGHUP):
        signal.signal(each, lambda *_: None)  # the signal's number is written into the pipe
    threading.Thread(target=_read_signals, args=(reader, stop, reload), name="signals", daemon=True).start()


def _read_signals(reader: int, stop: threading.Event, reload: Callable[[], object] | None) -> None:
    asked = False  # not by the event: a supervisor that ends sets it too
    while True:
        (number,) = os.read(reader, 1)
        if number == signal.SIGHUP:
            _reload(reload)
        elif asked:
            os._exit(128 + number)
        else:
            asked = True
            manager.stopping()
            stop.set()


def _reload(reload: Callable[[], object] | None) -> None:
    if reload is None:
        log.warning("SIGHUP: started without a configuration file, nothing is read again")
        return
    try:
        reload()
    except Exception as error:  # noqa: BLE001 - a wrong file must not end a service that works
        log.error("SIGHUP: the configuration stays as it is: %s", error)


def _stop_with_supervisor(stop: Stop) -> None:
    while os.read(sys.stdin.fileno(), 4096):  # unbuffered: a lock held at the interpreter's exit is fatal
        reserve.called.set()
    if not stop.is_set():
        log.error("the supervisor has ended without stopping this service; was it killed?")
        stop.orphaned = True
    stop.set()
