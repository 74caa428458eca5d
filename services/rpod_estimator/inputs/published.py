"""Sensors' topics that have a publisher, for the report about a sensor that never sends."""

from threading import Lock

from rpod_runtime import Node
from rpod_schemas.rmw.wire import EVERY_PUBLISHER, place_of_token
from rpod_schemas.topics import CONTRADICTION, ESTIMATE_JOINTS, Topic

_MOST_TOPICS, _MOST_NAMED = 1_000, 6
_SENSORS = "sensor_msgs/"
"""Beginning of the types of a sensor's messages."""
_ESTIMATORS = tuple(f"/{topic.name.rsplit('/', 1)[-1]}" for topic in (CONTRADICTION, ESTIMATE_JOINTS))
"""Ends of the names of an estimator's own topics of such types."""


class Published:
    """Publishers of sensors' topics, by their liveliness tokens. Safe to use from several threads."""

    def __init__(self) -> None:
        self._sessions: dict[str, set[str]] = {}
        self._elsewhere: dict[tuple[int, str], int] = {}
        """Number of publishers of sensors' topics in other domains, by domain and name."""
        self._lock = Lock()

    def watch(self, node: Node) -> None:
        """Watch the publishers of other ROS domains; on a secure bus they are not visible."""
        own = node.config.bus
        if own.credentials is None:
            node.watch_tokens(EVERY_PUBLISHER, lambda token, is_there: self.note(own.domain, token, is_there))

    def note(self, own: int, token: str, is_there: bool) -> None:
        """Note by its token that a publisher of another domain has appeared or gone."""
        domain, name, kind = place_of_token(token)
        if domain == own or not kind.startswith(_SENSORS):
            return
        place, step = (domain, name), 1 if is_there else -1
        with self._lock:
            if place in self._elsewhere or len(self._elsewhere) < _MOST_TOPICS:
                self._elsewhere[place] = self._elsewhere.get(place, 0) + step
                if self._elsewhere[place] <= 0:
                    del self._elsewhere[place]

    def came(self, session: str, topic: Topic) -> None:
        """Note a publisher."""
        with self._lock:
            known = topic.name in self._sessions or len(self._sessions) < _MOST_TOPICS
            is_sensors = topic.type.startswith(_SENSORS) and not topic.name.endswith(_ESTIMATORS)
            if is_sensors and known:
                self._sessions.setdefault(topic.name, set()).add(session)

    def gone(self, session: str, topic: Topic) -> bool:
        """Note that a publisher is gone; return whether it was the last known one of the topic."""
        with self._lock:
            sessions = self._sessions.get(topic.name, set())
            was_there = session in sessions
            sessions.discard(session)
            if not sessions:
                self._sessions.pop(topic.name, None)
            return was_there and not sessions

    def instead(self, awaited: str, refused: str = "") -> str:
        """Return what is published in place of an awaited topic, and what to do, for the operator.

        ``refused`` is why the last message of the topic was refused; empty if none was.
        """
        if refused:
            return f"messages on {awaited} come and are refused, {refused}; correct its driver"
        with self._lock:
            names, elsewhere = sorted(self._sessions), sorted(self._elsewhere)
        if awaited in names:
            return f"{awaited} has a publisher that sends nothing; look at its driver"
        if not names and elsewhere:
            domain, name = elsewhere[0]
            return (
                f"{awaited} is awaited; {name} is published in ROS domain {domain}: give driver and "
                "estimator the same domain (ROS_DOMAIN_ID, bus.domain)"
            )
        if not names:
            return f"{awaited} is awaited, and no sensor's topic is published; is its driver running?"
        more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        named = ", ".join(names[:_MOST_NAMED])
        return f"{awaited} is awaited, published are {named}{more}; set the sensor's name or its source"
