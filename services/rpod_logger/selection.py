"""Selection of what is recorded: topics of the ICD and of installed sensor kinds, and configured keys."""

from collections.abc import Sequence
from functools import lru_cache

import zenoh

from rpod_schemas.errors import ConfigurationError
from rpod_schemas.sensors import sensor_kinds
from rpod_schemas.topics import ESTIMATES, TOPICS, Namespace, Topic

_REMEMBERED = 4096
"""Number of keys whose expression is remembered; anybody may publish on keys without end."""


def patterns() -> list[Topic]:
    """Return the topics as patterns that do not overlap, so that nothing is subscribed twice."""
    of_sensors = [topic for kind in sensor_kinds() for topic in kind.topics]
    wanted = [_pattern(topic) for topic in (*TOPICS, *of_sensors)]
    return [
        topic
        for topic in dict.fromkeys(wanted)
        if not any(other.covers(topic) for other in wanted if other != topic)
    ]


def _pattern(topic: Topic) -> Topic:
    of_any = topic.name.startswith("<") or topic in ESTIMATES
    return (topic.under("*") if of_any else topic).at("*")


class Extras:
    """Key expressions to record beside the ICD's topics; a key belongs to the first that matches it."""

    def __init__(self, keys: Namespace, expressions: Sequence[str]) -> None:
        self.expressions = tuple(expressions)
        own = [_expression(keys.selector(pattern)) for pattern in patterns()]
        self._all = own + [_expression(text) for text in expressions]
        self._offset = len(own)
        self._first = lru_cache(_REMEMBERED)(self._find_first)

    def owns(self, index: int, key: str) -> bool:
        """Return whether a key belongs to the expression with this index."""
        return self._first(key) == self._offset + index

    def _find_first(self, key: str) -> int:
        return next(
            place for place, expression in enumerate(self._all) if expression.includes(zenoh.KeyExpr(key))
        )


def _expression(text: str) -> zenoh.KeyExpr:
    try:
        return zenoh.KeyExpr(text)
    except zenoh.ZError as error:
        raise ConfigurationError(
            "logger", "record_extra", f"{text!r} is not a Zenoh key expression: {error}"
        ) from error
