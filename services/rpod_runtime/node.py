"""A service on the bus: its session, endpoints, liveliness, health and control plane.

``with Node(...) as node:`` opens them. At the end they are undeclared in reverse order and the session is
closed last, because a subscriber that outlives its session hangs the interpreter.
"""

import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from threading import Event, Thread
from types import TracebackType
from typing import Any, Literal, Self, TypeVar

import zenoh
import zenoh.ext
from pydantic import BaseModel

from rpod_runtime.bus.link import Link
from rpod_runtime.bus.session import open_client
from rpod_runtime.bus.tokens import LONGEST_TOKEN, PublisherTokens, Tell
from rpod_runtime.clock import BusClock, Clock, WallClock
from rpod_runtime.delivery.accounting import MOST_KEYS, SequenceAccount
from rpod_runtime.delivery.inbox import Received
from rpod_runtime.delivery.publisher import Publisher
from rpod_runtime.delivery.receiving import Delivery
from rpod_runtime.health import HealthBook
from rpod_runtime.process.notify import manager
from rpod_runtime.process.reloading import describe, reloader
from rpod_runtime.process.reserve import await_turn
from rpod_runtime.requests.asker import Asker
from rpod_runtime.requests.control import Served
from rpod_runtime.requests.identity import open_identity
from rpod_runtime.requests.sole import Sole, be_sole
from rpod_runtime.ros import Form, RosGraph, trigger
from rpod_runtime.ros.offers import offer_watch
from rpod_runtime.ros.parameters import Parameters, flatten
from rpod_schemas.config.migration import logged
from rpod_schemas.config.service import ServiceConfig
from rpod_schemas.control import Accepted, Empty, StatusReply
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import write_diagnostics
from rpod_schemas.reload import ReloadReply
from rpod_schemas.rmw.wire import GraphNode, publisher_tokens, qos_of_token, session_of_token, topic_of_token
from rpod_schemas.topics import CLOCK, DIAGNOSTICS, SENSOR_CACHE, Service, Topic
from rpod_schemas.types import CLOSING, PUBLISHED, Health

log = logging.getLogger(__name__)

RequestT = TypeVar("RequestT", bound=BaseModel)
State = Literal["starting", "ready", "running", "finished", "stopping", "failed"]

_DIAGNOSTICS_PERIOD_S = 1.0
_CHANGE_POLL_S = 0.1
_FLOW_PERIOD_S = 0.9
"""Least time over which the rate of what arrives is taken, s: less than between two heartbeats."""
_LINGER_S = 0.3
"""Time that a node stays open after its last numbers, so that receivers can recover what they missed."""
_ROS_CLIENT = "a ROS 2 client"


class Node(Asker):
    """Represents one process on the bus; a process in reserve waits here until its turn has come.

    With ``sole`` it must be the only service of its name, and the only one that publishes some topics.
    """

    def __init__(
        self, config: ServiceConfig, *, version: str, stop: Event | None = None, sole: Sole | None = None
    ) -> None:
        self.config = config
        self.version = version
        self.stop = stop or Event()
        await_turn(self.stop)
        self.state: State = "starting"
        self.target_digest: str | None = None
        self.target_content: str | None = None
        self.health = HealthBook(config.instance)
        self.account = SequenceAccount()
        self.clock: Clock = BusClock() if config.in_lockstep else WallClock()
        self.link = Link(self.health, config.bus.connect)
        self._identity = open_identity(config)
        self._keys = config.bus.keys
        self._delivery = Delivery(self._keys, self.health, self.account)
        self._started_s = time.monotonic()
        self._next_flow_s = self._started_s + _FLOW_PERIOD_S
        self._entities, self._sole = 0, sole
        self._publishers: list[Publisher] = []
        self.parameters = Parameters({})
        """The node's parameters for ROS 2 tools, unless the configuration leaves them out."""
        self._clock_sinks: list[Callable[[Received], object]] = []
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with self._stack:  # a failure half-way leaves nothing open
            self._open()
            self._stack = self._stack.pop_all()
        return self

    def _open(self) -> None:
        self._session = self._stack.enter_context(
            open_client(self.config.bus, zenoh_id=self.config.zenoh_id, stop=self.stop)
        )
        self._stack.callback(self.link.watch(self._session))
        if self._sole:
            self._stack.callback(be_sole(self, self._session, self.config, self._sole, self.health))
        self._graph = GraphNode(self._keys, str(self._session.zid()), self.config.instance)
        self._token(self._graph.node_token())
        self._diagnostics = self.publisher(DIAGNOSTICS)
        self._ros = RosGraph(self, self._session, self._keys, self.config.instance)
        self._stack.callback(self._ros.close)
        self.serve("status", Empty, lambda _: self.status())
        self.serve("shutdown", Empty, self._shut_down, ros=trigger(Empty))
        if reloader.is_of(self.config):
            self.serve("reload", Empty, lambda _: reloader.reload())
            reloader.on_change(self._take_configuration)
        if self.config.bus.ros_services:
            self.parameters = self._ros.serve_parameters(
                logged(self.config), use_sim_time=self.config.in_lockstep
            )
        if isinstance(self.clock, BusClock):
            self.subscribe(CLOCK, partial(self._take_clock, self.clock), recover=True)
        self._heart = Thread(target=self._publish_heartbeats, name="diagnostics", daemon=True)
        self._heart.start()
        self._stack.callback(self._last_beat)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        serves = self.state in ("ready", "running", "finished")
        self.state = "failed" if kind else "stopping"
        self.stop.set()
        if serves:
            self._last_beat()  # once more at the end: this one can still be recovered
            time.sleep(_LINGER_S)
        self._stack.close()

    @property
    def session_id(self) -> str:
        """Zenoh identity of the session."""
        return self._graph.session_id

    # --- endpoints ---

    def publisher(self, topic: Topic) -> Publisher:
        """Declare a publisher that lives as long as the node."""
        publisher = self._stack.enter_context(Publisher(self._session, self._keys, topic))
        self._publishers.append(publisher)
        self._token(self._graph.endpoint_token("MP", self._entity(), topic))
        return publisher

    def subscribe(
        self,
        topic: Topic,
        sink: Callable[[Received], object],
        *,
        recover: bool = False,
        history: bool = False,
    ) -> None:
        """Subscribe to a topic; ``sink`` runs in the bus's thread and must only enqueue.

        Duplicates and messages without a usable attachment are counted and not delivered. With ``recover``
        missed samples are requested again. With ``history`` earlier samples are fetched, as far as the
        publisher keeps them; the last sample of a latched topic is always fetched.
        """
        self._subscribe(topic, sink, recover=recover, history=history)
        self._token(self._graph.endpoint_token("MS", self._entity(), topic))
        if topic.latched:
            tell = offer_watch(topic, self.health.warn)
            self.watch_tokens(publisher_tokens(self._keys, topic), lambda token, _: tell(token))

    def subscribe_all(
        self, patterns: Sequence[Topic], sink: Callable[[Received], object], *, recover: bool = True
    ) -> None:
        """Subscribe to all topics that match one of the patterns (``*`` stands for a part of the name).

        A liveliness token has no wildcards, so a token is declared for each topic when its first publisher
        appears, of 1,000 topics at most, as messages are received. Without it newer rmw_zenoh publishers of
        images and point clouds send nothing.
        """
        for pattern in patterns:
            self._subscribe(pattern, sink, recover=recover, history=recover)
        shown: set[Topic] = set()

        def show(token: str, _: bool) -> None:
            topic = topic_of_token(token, self._keys) if len(token) <= LONGEST_TOKEN else None
            if topic is None or topic in shown or len(shown) >= MOST_KEYS:
                return
            if not any(pattern.covers(topic) for pattern in patterns):
                return
            shown.add(topic)
            self._token(self._graph.endpoint_token("MS", self._entity(), topic))

        self.watch_tokens(publisher_tokens(self._keys), show)

    def watch_publishers(self, gone: Tell, came: Tell) -> None:
        """Call ``came`` with session and topic for each publisher's token, ``gone`` when its last is gone.

        ``came`` is called at once for those that are there.
        """
        tokens = PublisherTokens(self._keys, came=came, gone=gone)
        self.watch_tokens(publisher_tokens(self._keys), tokens.take)

    def watch_tokens(self, pattern: str, take: Callable[[str, bool], None]) -> None:
        """Call ``take`` in the bus's thread with each liveliness token and whether it comes or vanishes.

        It is called at once for the tokens that are there.
        """
        watcher = self._session.liveliness().declare_subscriber(
            pattern,
            lambda sample: take(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT),
            history=True,
        )
        self._stack.callback(watcher.undeclare)

    def watch_publisher_qos(self, tell: Callable[[tuple[str, str, str]], None]) -> None:
        """Call ``tell`` with topic, quality of service and session of each publisher, by its token.

        It runs in the bus's thread, at once for the publishers that are there, then for those that come.
        """

        def take(token: str, is_there: bool) -> None:
            topic = topic_of_token(token, self._keys)
            if is_there and topic is not None:
                tell((topic.name, qos_of_token(token), session_of_token(token)))

        self.watch_tokens(publisher_tokens(self._keys), take)

    def _subscribe(
        self, topic: Topic, sink: Callable[[Received], object], *, recover: bool, history: bool
    ) -> None:
        past = topic.kept if history else 0
        self._declare(
            self._keys.selector(topic),
            lambda sample: self._delivery.take(topic, sample, sink),
            kept=1 if topic.latched else past,
            recover=recover,
        )

    def listen(
        self, key_expression: str, sink: Callable[[Received], object], *, accept: Callable[[str], bool]
    ) -> None:
        """Subscribe, with recovery, to the keys that ``accept`` accepts; they need not be ROS topics.

        A message of an unknown topic has no type, and no attachment if the publisher sent none.
        """

        def take(sample: zenoh.Sample) -> None:
            if accept(str(sample.key_expr)):
                self._delivery.take_any(sample, sink)

        self._declare(key_expression, take, kept=SENSOR_CACHE, recover=True)

    def follow_clock(self, sink: Callable[[Received], object]) -> None:
        """Deliver each message of ``clock`` after the node's clock is set; ``sink`` must only enqueue."""
        self._clock_sinks.append(sink)

    def _take_clock(self, clock: BusClock, received: Received) -> None:
        clock.set(received.decode())
        for sink in self._clock_sinks:
            sink(received)

    def _declare(
        self, key_expression: str, take: Callable[[zenoh.Sample], None], *, kept: int, recover: bool
    ) -> None:
        """Subscribe, and fetch up to ``kept`` earlier samples."""
        past = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=kept) if kept else None
        recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if recover else None
        subscriber = zenoh.ext.declare_advanced_subscriber(
            self._session, key_expression, take, history=past, recovery=recovery
        )
        self._stack.callback(subscriber.undeclare)
        if recover:
            self._stack.callback(subscriber.sample_miss_listener(self._delivery.miss).undeclare)

    def reject(self, topic: str, error: MessageRejectedError) -> None:
        """Count a rejected message; log the first of its kind, and then one a minute."""
        self._delivery.reject(topic, error)

    def _entity(self) -> int:
        self._entities += 1
        return self._entities

    def _token(self, key: str) -> None:
        token = self._session.liveliness().declare_token(key)
        self._stack.callback(token.undeclare)

    # --- control plane ---

    def serve(
        self,
        verb: str,
        request: type[RequestT],
        handler: Callable[[RequestT], BaseModel],
        *,
        ros: Form[RequestT] | None = None,
    ) -> None:
        """Answer a control-plane query with a model; an exception of the handler becomes an error reply.

        With ``ros`` it is answered as a ROS 2 service too, unless the configuration leaves them out.
        """
        served = Served(self._keys, self.config.instance, verb, request, handler, self._identity, self.health)
        self._stack.callback(self._session.declare_queryable(served.key, served.answer).undeclare)
        if ros is not None and self.config.bus.ros_services:

            def obey(call: Any) -> Any:
                request = (asked := ros.request(call)).model_dump_json()
                self._identity.record(asker=_ROS_CLIENT, verb=verb, request=request, outcome="asked")
                reply = handler(asked)
                self.note_command(verb, request)
                return ros.accepted(reply)

            self._ros.serve(verb, ros.type, answer=obey, refuse=ros.refused)

    def show(self, service: Service) -> None:
        """Declare the liveliness token of a ROS 2 service, by which clients find it."""
        self._token(self._graph.endpoint_token("SS", self._entity(), service))

    def note_command(self, verb: str, request: str) -> None:
        """Keep a command of a ROS 2 client in diagnostics, log and audit record."""
        self._identity.record(asker=_ROS_CLIENT, verb=verb, request=request, outcome="accepted")
        self.health.note_command(verb, request)

    def status(self) -> StatusReply:
        """Return the state, the counters and the configuration of this service."""
        self._update_counters()
        return StatusReply(
            name=self.config.instance,
            version=self.version,
            state=self.state,
            uptime_s=time.monotonic() - self._started_s,
            counters=self.health.counters(),
            configuration=logged(self.config),
            target_digest=self.target_digest,
            target_content=self.target_content,
        )

    def _shut_down(self, _: Empty) -> Accepted:
        self.stop.set()
        return Accepted()

    def _take_configuration(self, config: BaseModel, reply: ReloadReply) -> None:
        """Tell of a configuration that was read again: in status, diagnostics and the audit record."""
        text = describe(reply)
        self._identity.record(asker="its file", verb="reload", request=reply.model_dump_json(), outcome=text)
        if isinstance(config, ServiceConfig):
            self.config = config
        for name, value in flatten(reply.changed):
            self.parameters.renew(name, value)
        self.health.set_text("configuration/read_again", text)
        names = ", ".join(reply.needs_restart)
        differs = f"the file differs in {names}: restart the service, or correct it"
        self.health.alarm("configuration", differs if names else "")

    # --- life ---

    def ready(self, message: str) -> None:
        """Report that the service is ready for work."""
        self.state = "ready"
        self.health.report(Health.OK, message)
        log.info("ready: %s", message)
        manager.ready(message)

    def _publish_heartbeats(self) -> None:
        next_s = time.monotonic()
        while not self.stop.is_set():
            if self.health.take_change() or time.monotonic() >= next_s:
                self._publish_health()
                next_s = time.monotonic() + _DIAGNOSTICS_PERIOD_S
            self.stop.wait(_CHANGE_POLL_S)

    def _last_beat(self) -> None:
        self.stop.set()
        self._heart.join(timeout=2.0)
        self.health.set_text(CLOSING, "true")
        self._publish_health()

    def _publish_health(self) -> None:
        if time.monotonic() >= self._next_flow_s:
            self._next_flow_s = time.monotonic() + _FLOW_PERIOD_S
            for name, value in self._delivery.flow.take().items():
                self.health.measure(name, value)
        self.health.alarm("certificate", self._identity.warning())
        self._update_counters()
        self._diagnostics.publish(write_diagnostics([self.health.diagnostic(time.time_ns())]))

    def _update_counters(self) -> None:
        totals: Counter[str] = Counter()  # several publishers, or type hashes, may share a topic
        for publisher in self._publishers:
            totals[f"{PUBLISHED}{publisher.topic.name}"] += publisher.published
        for key, count in list(self.account.counts.items()):
            topic = self._keys.topic_at(key).name
            totals[f"received/{topic}"] += count.received
            totals[f"missed/{topic}"] += count.missed
            totals[f"recovered/{topic}"] += count.recovered
        for name, total in totals.items():
            self.health.put(name, total)
