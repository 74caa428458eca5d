"""The router service, with access rules that keep the truth from the estimators."""

import logging
from threading import Event

from rpod_runtime.notify import manager
from rpod_runtime.session import open_router
from rpod_schemas.config.service import RouterConfig

log = logging.getLogger(__name__)


def run(config: RouterConfig, *, stop: Event) -> None:
    """Route until stopped. Raises ``EndpointError``."""
    with open_router(config):
        log.info("ready: listening on %s", config.listen)
        manager.ready(f"listening on {config.listen}")
        manager.attend(stop)
