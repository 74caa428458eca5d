"""The view daemon: draws the newest messages of the bus and publishes nothing but its health.

It subscribes without recovery to what it draws and keeps a bounded number of messages. It draws at most ten
times a second, and only when the viewer has received everything that was drawn before.
"""

import logging
import time
from threading import Event

from rpod_runtime import Inbox, Node
from rpod_runtime.process.notify import manager
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.topics import TF, TRUTH
from rpod_target import Target, TargetError, load_target
from rpod_view.scene import pose_topics, sensor_topics
from rpod_view.view import View
from rpod_view.viewer.viewer import open_viewer

log = logging.getLogger(__name__)

_WAITING_PARTS = 128
"""Largest number of parts of frames that wait to be drawn, the newest ones; about 30 MB of images."""
_WAITING = 2048
_PATIENCE_S = 0.05
"""Time for the viewer to receive what was drawn one period before."""


def run(config: ViewConfig, *, version: str, stop: Event) -> None:
    """Show what is on the bus until stopped, or until the viewer is closed."""
    with Node(config, version=version, stop=stop) as node, open_viewer(config, stop) as viewer:
        target = _target(node, config.target)
        view = View(viewer.recording, target=target, prefix=config.prefix, reject=node.reject)
        subscriptions = _Subscriptions(node, config)
        node.ready(f"{viewer.how} {viewer.where}")
        next_s = time.monotonic()
        while not stop.wait(max(next_s - time.monotonic(), 0.0)):
            manager.alive()
            next_s = max(next_s, time.monotonic()) + 1.0 / config.rate_hz
            if viewer.closed:
                log.info("the viewer was closed")
                return
            subscriptions.hand_over(view)
            if viewer.has_taken(_PATIENCE_S):
                node.health.count("drawn", view.draw(time.monotonic()))
            else:
                node.health.count("skipped")


def _target(node: Node, name: str | None) -> Target | None:
    """Return the configured target; if none is configured, the target of a service on the bus.

    Raises:
        TargetError: the configured target does not exist.
    """
    if name is not None:
        return load_target(name)
    targets = (reply.configuration.get("target") for reply in node.ask_all())
    found = next((target for target in targets if target and isinstance(target, str)), None)
    try:
        return load_target(found) if found else None
    except TargetError as error:
        log.warning("the target's mesh is not shown: %s", error)
        return None


class _Subscriptions:
    """Subscriptions of the view; messages that are not fetched in time are dropped on purpose."""

    def __init__(self, node: Node, config: ViewConfig) -> None:
        self._node = node
        self._parts, self._others = Inbox(_WAITING_PARTS), Inbox(_WAITING)
        truth = TF if config.truth == "tf" else TRUTH
        for topic in (truth, *pose_topics(config.prefix)):
            node.subscribe(topic, self._others.put)
        node.subscribe_all(sensor_topics(), self._parts.put, recover=False)

    def hand_over(self, view: View) -> None:
        """Pass all messages received so far to the view."""
        for received in self._others.wait(0.0) + self._parts.wait(0.0):
            view.take(received)
        self._node.health.put("overflowed/inbox", self._parts.overflowed + self._others.overflowed)
