"""The view daemon: the bus's newest onto the screen, and nothing of it back.

It subscribes without recovery to what it draws, keeps a bounded number of messages, and draws at most
ten times a second, and only once the viewer has taken what was drawn before.
"""

import logging
import time
from threading import Event

from rpod_runtime import Inbox, Node
from rpod_schemas.config.view import ViewConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.topics import TF, TRUTH
from rpod_target import Target, TargetError, load_target
from rpod_view.scene import pose_topics, sensor_topics
from rpod_view.view import View
from rpod_view.viewer import open_viewer

log = logging.getLogger(__name__)

_WAITING_PARTS = 128
"""Parts of frames between the bus and the drawing: the newest, some 30 MB of images."""
_WAITING = 2048
_PATIENCE_S = 0.05
"""For the viewer to take what was drawn a period ago."""


def run(config: ViewConfig, *, version: str, stop: Event) -> None:
    """Show what is on the bus until stopped, or until the viewer is closed."""
    with Node(config, version=version, stop=stop) as node, open_viewer(config, stop) as viewer:
        target = _target(node, config.target)
        view = View(viewer.recording, target=target, prefix=config.prefix, reject=node.reject)
        ears = _Ears(node, config)
        node.ready(f"to be seen in {viewer.where}")
        next_s = time.monotonic()
        while not stop.wait(max(next_s - time.monotonic(), 0.0)):
            next_s = max(next_s, time.monotonic()) + 1.0 / config.rate_hz
            if viewer.closed:
                log.info("the viewer was closed")
                return
            ears.hand_over(view)
            if viewer.has_taken(_PATIENCE_S):
                node.health.count("drawn", view.draw())
            else:
                node.health.count("skipped")


def _target(node: Node, name: str | None) -> Target | None:
    """Return the target that is configured, else the one that a service on the bus says it has.

    Raises:
        TargetError: there is no such target as is configured.
    """
    if name is not None:
        return load_target(name)
    targets = (reply.configuration.get("target") for reply in node.ask_all("status", StatusReply))
    found = next(filter(None, targets), None)
    try:
        return load_target(found) if found else None
    except TargetError as error:
        log.warning("no mesh: %s", error)
        return None


class _Ears:
    """Topics that the view subscribes to; messages that are not fetched in time are dropped on purpose."""

    def __init__(self, node: Node, config: ViewConfig) -> None:
        self._node = node
        self._parts, self._others = Inbox(_WAITING_PARTS), Inbox(_WAITING)
        truth = TF if config.truth == "tf" else TRUTH
        for topic in (truth, *pose_topics(config.prefix)):
            node.subscribe(topic, self._others.put)
        node.subscribe_all(sensor_topics(), self._parts.put, recover=False)

    def hand_over(self, view: View) -> None:
        """Give the view everything that has come."""
        for received in self._others.wait(0.0) + self._parts.wait(0.0):
            view.take(received)
        self._node.health.put("overflowed/inbox", self._parts.overflowed + self._others.overflowed)
