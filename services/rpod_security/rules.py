"""Access rules for the router, made from the members of a facility: what no rule allows is denied.

What a client sends (``ingress``) decides what it can do. What the router hands to it (``egress``) is limited
too, so that a mistake in one rule does not open a way. Zenoh allows a message if one rule's key expression
includes the message's. ``**`` does not match the chunks ``@adv`` (caches, heartbeats) and ``@ros2_lv``
(tokens), so rules name them.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import zenoh

from rpod_schemas.rmw.wire import publisher_tokens, token_pattern
from rpod_schemas.topics import (
    BODY,
    CLOCK,
    COMMAND,
    DIAGNOSTICS,
    FAULTS,
    IMU,
    PARAMETER_EVENTS,
    ROSOUT,
    SUN,
    TF,
    TF_STATIC,
    TRUTH,
    Namespace,
    Topic,
)
from rpod_security.errors import RulesError
from rpod_security.roles import ANY, LINK, ROLES, ROUTER, Member

Flow = Literal["ingress", "egress"]
Grant = tuple[Flow, tuple[str, ...], list[str]]
"""A right of a member: direction, kinds of messages, and key expressions."""
_CACHES, _PUBLISHERS = "@adv/**", "@adv/pub/**"
_SHARED = frozenset(
    {TF, TF_STATIC, FAULTS, DIAGNOSTICS, ROSOUT, PARAMETER_EVENTS, TRUTH, SUN, IMU, COMMAND, CLOCK}
    | {BODY.at("*")}
)
"""Topics for which the ICD names several senders."""
_WATCH = ("declare_liveliness_subscriber", "liveliness_query")


@dataclass(frozen=True)
class RosService:
    """A ROS 2 service, with the one member that serves it and the one that may call it."""

    name: str
    """Name without the leading slash, under the facility's namespace."""
    server: str
    client: str


@dataclass(frozen=True)
class OtherHost:
    """The router of another host, joined to this one: it acts for the members there alone."""

    members: frozenset[str]
    """Names of the members that connect to it."""
    common_names: tuple[str, ...]
    """Common names by which it is known here: of its certificate, and of its link's."""


class Rules:
    """Access rules of a facility."""

    def __init__(
        self, keys: Namespace, members: Iterable[Member], services: Sequence[RosService] = ()
    ) -> None:
        self._keys = keys
        clients = [member for member in members if member.role not in (ROUTER, LINK)]
        prefixes = tuple(member.prefix for member in clients if member.role == "estimator")
        self.members = tuple(replace(member, prefixes=prefixes) for member in clients)
        _check_one_sender(self.members)
        self._services = tuple(services)
        self._read = {
            member.name: [keys.selector(topic) for topic in member.reads] + list(member.extra)
            for member in self.members
        }

    def access_control(
        self, common_names: Mapping[str, str], other: OtherHost | None = None
    ) -> dict[str, Any]:
        """Return Zenoh's configuration ``access_control`` of one router.

        Args:
            common_names: common name of the valid certificate of each member that has one, by its name; a
                member without one may do nothing.
            other: the router of another host, if one is joined; its members have no rights here of their own.
        """
        far = other.members if other else frozenset()
        rules: list[dict[str, Any]] = []
        subjects, policies = [], []
        for member in self.members:
            if member.name not in common_names or member.name in far:
                continue
            own = _allowed(member.name, self._of(member))
            rules += own
            subjects.append({"id": member.name, "cert_common_names": [common_names[member.name]]})
            policies.append({"rules": [rule["id"] for rule in own], "subjects": [member.name]})
        if other is not None:
            own = [
                rule
                for member in self.members
                if member.name in far and member.name in common_names
                for rule in _allowed(f"{LINK} {member.name}", [*self._of(member), *self._found_by(member)])
            ]
            rules += own
            subjects.append({"id": LINK, "cert_common_names": list(other.common_names)})
            policies.append({"rules": [rule["id"] for rule in own], "subjects": [LINK]})
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        }

    def _of(self, member: Member) -> list[Grant]:
        return [*self._publishing(member), *self._reading(member), *self._control(member)]

    def _found_by(self, member: Member) -> list[Grant]:
        """Return what a router may tell the router of a member: the queryables that answer the member."""
        served = [
            self._keys.control(other.name, verb, ANY)
            for other in self.members
            for verb in (*member.asks(other), *(("status",) if member.asks_all else ()))
        ]
        services = [self._service(each) for each in self._services if each.client == member.name]
        caches = _under(self._read[member.name], _PUBLISHERS)
        return [("egress", ("declare_queryable",), [*caches, *served, *services])]

    def _publishing(self, member: Member) -> list[Grant]:
        """Return the rules for what it publishes: topics, caches for missed messages, and tokens."""
        own = [self._keys.selector(topic) for topic in member.publishes]
        caches = _under(own, _PUBLISHERS)
        asked = self._asked(own)
        return [
            ("ingress", ("put", "reply"), own + caches),
            ("ingress", ("declare_queryable",), caches),
            ("ingress", ("liveliness_token",), caches + self._tokens(member)),
            ("egress", ("declare_subscriber",), asked + _under(asked, _PUBLISHERS)),
            ("egress", ("query",), _under(asked, _CACHES)),
        ]

    def _reading(self, member: Member) -> list[Grant]:
        read = self._read[member.name]
        caches = _under(read, _PUBLISHERS)
        role = ROLES[member.role]
        tokens = [publisher_tokens(self._keys)] if role.watches else []
        tokens += [publisher_tokens(self._keys, topic) for topic in role.sole_topics]
        tokens += [token_pattern(self._keys, "NN", member.name)] if role.is_sole else []
        return [
            ("ingress", ("declare_subscriber",), read + caches),
            ("ingress", ("query",), _under(read, _CACHES)),
            ("ingress", _WATCH, caches + tokens),
            ("egress", ("put", "reply"), read + caches),
            ("egress", ("liveliness_token",), caches + tokens),
        ]

    def _control(self, member: Member) -> list[Grant]:
        """Return the rules of control plane and ROS services; keys end with the name of the client."""
        served = [self._keys.control(member.name, verb, ANY) for verb in member.serves]
        asked = [
            self._keys.control(other.name, verb, member.name)
            for other in self.members
            for verb in member.asks(other)
        ]
        if member.asks_all:
            asked.append(self._keys.control(ANY, "status", member.name))
        elif ROLES[member.role].is_sole:
            asked.append(self._keys.control(member.name, "status", member.name))
        services_served = [self._service(each) for each in self._services if each.server == member.name]
        services_asked = [self._service(each) for each in self._services if each.client == member.name]
        return [
            ("ingress", ("declare_queryable", "reply"), served + services_served),
            ("egress", ("query",), [*served, self._keys.control(ANY, "status", ANY), *services_served]),
            ("ingress", ("query",), asked + services_asked),
            ("egress", ("reply",), asked + services_asked),
        ]

    def _service(self, service: RosService) -> str:
        return f"{self._keys.root}/{service.name}/*/*"

    def _tokens(self, member: Member) -> list[str]:
        endpoints = {"MP": member.publishes, "MS": member.reads}
        found = [token_pattern(self._keys, "NN", member.name)]
        found += [
            token_pattern(self._keys, kind, member.name, topic)
            for kind, topics in endpoints.items()
            for topic in topics
        ]
        sides = {"SS": "server", "SC": "client"}
        return found + [
            token_pattern(self._keys, kind, member.name, Topic(each.name, ""))
            for kind, side in sides.items()
            for each in self._services
            if getattr(each, side) == member.name
        ]

    def _asked(self, own: Sequence[str]) -> list[str]:
        """Return the key expressions by which members may read something of a publisher."""
        keys = [zenoh.KeyExpr(key) for key in own]
        read = dict.fromkeys(key for keys_read in self._read.values() for key in keys_read)
        return [key for key in read if any(zenoh.KeyExpr(key).intersects(each) for each in keys)]


def _allowed(name: str, granted: Iterable[Grant]) -> list[dict[str, Any]]:
    return [
        {
            "id": f"{name} {flow} {messages[0]} {number}",
            "permission": "allow",
            "flows": [flow],
            "messages": list(messages),
            "key_exprs": list(dict.fromkeys(key_exprs)),
        }
        for number, (flow, messages, key_exprs) in enumerate(granted)
        if key_exprs
    ]


def _check_one_sender(members: Sequence[Member]) -> None:
    """Raise ``RulesError`` where two members could publish a topic that has one sender."""
    senders: dict[Topic, Member] = {}
    for member in members:
        for topic in member.publishes:
            if topic in _SHARED or member.role == "replay":
                continue
            for other_topic, other in senders.items():
                if other.name != member.name and (topic.covers(other_topic) or other_topic.covers(topic)):
                    raise RulesError(
                        member.name,
                        f"would publish {topic.name} as {other.name} does; give one of them another prefix "
                        "or sensor name, or take one out",
                    )
            senders[topic] = member


def _under(keys: Iterable[str], suffix: str) -> list[str]:
    return [f"{key}/{suffix}" for key in keys]


def load_access_control(file: Path) -> dict[str, Any]:
    """Read rules that ``rpod pki rules`` wrote. Raises ``RulesError``."""
    try:
        document = json.loads(file.read_text("utf-8"))
    except OSError as error:
        raise RulesError(file, f"cannot be read ({error.strerror}); make it with 'rpod pki rules'") from error
    except (ValueError, RecursionError) as error:
        raise RulesError(file, "is no JSON; make it with 'rpod pki rules'") from error
    if (
        not isinstance(document, dict)
        or document.get("enabled") is not True
        or document.get("default_permission") != "deny"
    ):
        raise RulesError(file, "holds no rules that deny by default; make them with 'rpod pki rules'")
    return document
