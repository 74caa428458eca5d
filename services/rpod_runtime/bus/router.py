"""The router service, with access rules: what each role may do, or at least what estimators may not read."""

import logging
import resource
from contextlib import ExitStack
from pathlib import Path
from threading import Event

from rpod_runtime.bus.refusal import telling_refusals
from rpod_runtime.bus.session import open_router
from rpod_runtime.process.notify import manager
from rpod_runtime.process.reserve import await_turn
from rpod_schemas.config.service import RouterConfig

log = logging.getLogger(__name__)

_DAY_S = 86_400.0


def run(config: RouterConfig, *, stop: Event) -> None:
    """Route until stopped. Raises ``EndpointError``, ``CredentialsError``, ``RulesError``.

    A router in reserve binds its port when its turn has come.
    """
    _raise_descriptor_limit()
    await_turn(stop)
    with ExitStack() as stack:
        if config.credentials:
            stack.enter_context(telling_refusals())
        stack.enter_context(open_router(config))
        log.info("ready: listening on %s", config.listen)
        manager.ready(f"listening on {config.listen}")
        while not stop.is_set():
            if config.credentials:
                _tell_end(config.credentials)
            manager.attend(stop, _DAY_S)


def _raise_descriptor_limit() -> None:
    """Allow as many open sockets as the system does, so that idle ones do not use up the descriptors."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _tell_end(folder: Path) -> None:
    """Log a warning if the router's certificate ends soon."""
    from rpod_security.credentials import ExpiryWatch  # noqa: PLC0415 - of an extra

    warning = ExpiryWatch(folder).warning()
    if warning:
        log.warning("%s; the router takes a new one when it is started again", warning)
