"""What a certificate allows on a live bus: each role against each key of the ICD, allowed and denied."""

import re
from collections import Counter, defaultdict
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from threading import Event

import pytest
import zenoh
import zenoh.ext
from secure_bus import KEYS, SecureBus, members, secure_bus

from rpod_schemas.rmw.wire import Attachment, GraphNode
from rpod_schemas.topics import TOPICS, TRUTH_TOPICS, Topic

ICD = Path(__file__).parents[2] / "schemas" / "ICD.md"
TIMEOUT_S = 60.0
NUMBERS = count()


def last_key() -> str:
    """Return a new key on which every role may publish, and that is published last."""
    return f"0/diagnostics/diagnostic_msgs::msg::dds_::DiagnosticArray_/last{next(NUMBERS)}"


SENDERS = {
    "motion": {"motion"},
    "motion, or the robots' driver": {"motion", "robots"},
    "the robots' driver": {"robots"},
    "motion, or the lamp's driver": {"motion", "lamp"},
    "each sensor, all its transforms in one message": {"emulator", "driver"},
    "latched": {"emulator", "driver"},
    "motion, estimator": {"motion", "estimator"},
    "motion in lockstep, replay": {"motion"},
    "camera": {"emulator", "driver"},
    "LIDAR": {"emulator"},
    "estimator": {"estimator"},
    "the user's guidance, or motion": {"guidance", "motion"},
    "the chaser, or motion": {"chaser", "motion"},
    "emulator, proxy, supervisor, logger": {"emulator", "proxy", "operator", "logger"},
    "every service": {member.name for member in members()},
}
"""Roles of the test's facility by the words of the ICD's column "from"."""

EVERYBODY = {member.name for member in members()}
SHOWN = {"logger", "view"}
READERS = {
    "truth/odometry": SHOWN | {"emulator"},
    "truth/joints": {"logger"},
    "motion/reference": {"logger", "robots"},
    "environment/sun": {"logger", "emulator"},
    "tf_static": SHOWN | {"estimator"},
    "tf": SHOWN | {"operator"},
    "clock": SHOWN | {"emulator", "driver", "estimator", "operator", "guidance"},
    "guidance/command": {"logger", "estimator"},
    "chaser/imu": {"logger", "estimator"},
    "bodies/<frame>/odometry": {"logger", "estimator"},
    "faults": {"logger"},
    "rosout": {"logger"},
    "parameter_events": {"logger"},
    "diagnostics": SHOWN | {"estimator", "operator", "guidance"},
    "estimate/status": SHOWN | {"operator", "guidance", "motion"},
}
OF_SENSORS = SHOWN | {"estimator"}
OF_ESTIMATES = SHOWN | {"operator", "guidance"}


def resolved(topic: Topic) -> Topic:
    """Return a topic as the test's facility has it."""
    sensor = "lidar" if topic.name.startswith("<lidar>") else "pmd"
    named = topic.of(sensor) if topic.name.startswith("<") else topic
    return named.at("grapple") if "<frame>" in named.name else named


def senders() -> dict[str, set[str]]:
    """Return who may publish what, read from the ICD."""
    rows = re.findall(
        r"^\| `([\w/<>]+)` \| \w+/\w+[^|]* \| [^|]* \| ([^|]*) \|", ICD.read_text("utf-8"), re.M
    )
    return {name: SENDERS[words.strip()] for name, words in rows}


def readers(topic: Topic) -> set[str]:
    """Return who may read a topic, as this test states it."""
    if topic.name.startswith("<"):
        return OF_SENSORS
    return READERS.get(topic.name, OF_ESTIMATES)


@pytest.fixture(scope="module")
def bus(tmp_path_factory):
    with secure_bus(tmp_path_factory.mktemp("secure")) as bus:
        yield bus


@pytest.fixture(scope="module")
def clients(bus: SecureBus):
    with ExitStack() as stack:
        yield {member.name: stack.enter_context(bus.client(member.name)) for member in members()}


class Ears:
    """Notes which payload came on which key, and when the last one has come twice from everybody.

    The first time it may come before the subscription of another key was known to the sender.
    """

    def __init__(self, expected: set[str]) -> None:
        self.last_key = last_key()
        self.heard: dict[str, set[str]] = defaultdict(set)
        self._missing = Counter(2 * list(expected))
        self.done = Event()

    def __call__(self, sample: zenoh.Sample) -> None:
        key, sender = str(sample.key_expr), sample.payload.to_string()
        if key == self.last_key:
            self._missing.subtract([sender])
            if max(self._missing.values()) <= 0:
                self.done.set()
        else:
            self.heard[key].add(sender)


def test_each_role_publishes_what_the_icd_says_and_nothing_else(clients):
    allowed = senders()
    with ExitStack() as stack:
        logger = clients["logger"]
        ears = Ears(EVERYBODY - {"logger"})
        topics = {topic: KEYS.key(resolved(topic)) for topic in TOPICS}
        for key in [*topics.values(), ears.last_key]:
            stack.callback(logger.declare_subscriber(key, ears).undeclare)
        for _ in range(600):
            for name in EVERYBODY - {"logger"}:
                for key in topics.values():
                    clients[name].put(key, name)
                clients[name].put(ears.last_key, name)
            if ears.done.wait(0.1):
                break
        assert ears.done.is_set()
    wrong = {
        topic.name: (ears.heard[key], allowed[topic.name])
        for topic, key in topics.items()
        if ears.heard[key] != allowed[topic.name] - {"logger"} - ({"driver"} if "<" in topic.name else set())
    }
    assert not wrong


def test_a_sensors_driver_publishes_as_no_other_sensor(clients):
    (info,) = [topic for topic in TOPICS if topic.name == "<camera>/info"]
    keys = {sensor: KEYS.key(info.of(sensor)) for sensor in ("cam", "pmd")}
    logger = clients["logger"]
    ears = Ears({"driver", "emulator"})
    with ExitStack() as stack:
        for key in [*keys.values(), ears.last_key]:
            stack.callback(logger.declare_subscriber(key, ears).undeclare)
        for _ in range(600):
            for name in ("driver", "emulator"):
                for key in keys.values():
                    clients[name].put(key, name)
                clients[name].put(ears.last_key, name)
            if ears.done.wait(0.1):
                break
        assert ears.done.is_set()
    assert ears.heard == {keys["cam"]: {"driver"}, keys["pmd"]: {"emulator"}}


def settle(clients: dict[str, zenoh.Session]) -> None:
    """Wait until what was sent has come: a query that is allowed takes the way of the messages and back."""
    for member in members():
        for topic in member.reads[:1]:
            list(clients[member.name].get(f"{KEYS.selector(topic)}/@adv/**", timeout=TIMEOUT_S))
    for member in members():
        key = f"{KEYS.root}/rpod/nobody/status/by/{member.name}"
        list(clients[member.name].get(key, timeout=0.01))


def test_each_role_reads_what_it_has_to_and_nothing_else(clients):
    topics = {KEYS.key(resolved(topic)): topic for topic in TOPICS}
    first = {"motion", "emulator", "estimator", "guidance", "chaser", "robots"}
    origin = {key: min(senders()[topic.name] & first) for key, topic in topics.items()}
    heard: dict[str, set[str]] = defaultdict(set)
    with ExitStack() as stack:
        for name, session in clients.items():
            for key in topics:
                sink = heard[name]
                subscriber = session.declare_subscriber(
                    key, lambda sample, sink=sink: sink.add(str(sample.key_expr))
                )
                stack.callback(subscriber.undeclare)
        settle(clients)
        for key, name in origin.items():
            clients[name].put(key, "x")
        settle(clients)
    wrong = {
        (name, topic.name)
        for name in EVERYBODY
        for key, topic in topics.items()
        if origin[key] != name and (key in heard[name]) != (name in readers(topic))
    }
    assert not wrong


ROLES_WITHOUT_TRUTH = sorted(EVERYBODY - {"logger", "view", "emulator", "motion", "robots", "operator"})


@pytest.mark.parametrize("name", ROLES_WITHOUT_TRUTH)
@pytest.mark.parametrize(
    "selector", ["**", "{key}", "0/**", "{key}/@adv/**", "**/@adv/**", "0/*/odometry/**"]
)
def test_no_way_of_asking_gives_the_truth_to_a_role_without_it(clients, name, selector):
    heard: list[str] = []
    session, known = clients[name], Event()
    with ExitStack() as stack:
        for topic in TRUTH_TOPICS:
            asked = selector.format(key=KEYS.key(topic))
            subscriber = session.declare_subscriber(asked, lambda sample: heard.append(str(sample.key_expr)))
            stack.callback(subscriber.undeclare)
        logger = clients["logger"].declare_subscriber(KEYS.key(TRUTH_TOPICS[-1]), lambda _: known.set())
        stack.callback(logger.undeclare)
        publishers = []
        for topic in TRUTH_TOPICS:
            publisher = zenoh.ext.declare_advanced_publisher(
                clients["motion"],
                KEYS.key(topic),
                cache=zenoh.ext.CacheConfig(max_samples=5),
                publisher_detection=True,
            )
            stack.callback(publisher.undeclare)
            publishers.append(publisher)
        for _ in range(1200):
            for publisher in publishers:
                publisher.put("truth")
            if known.wait(0.05):
                break
        assert known.is_set()
        for topic in TRUTH_TOPICS:
            asked = selector.format(key=KEYS.key(topic))
            answers = session.get(f"{asked}?_anyke", target=zenoh.QueryTarget.ALL, timeout=0.05)
            heard += [str(answer.ok.key_expr) for answer in answers if answer.ok]
    assert not [key for key in heard if any(f"/{topic.name}/" in key for topic in TRUTH_TOPICS)]


# --- forged ---


@pytest.mark.parametrize("name", ["view", "guidance", "lamp"])
def test_of_ten_thousand_forged_messages_none_is_delivered(clients, name):
    mine = {topic.name for topic in TOPICS if name in senders()[topic.name]}
    keys = [KEYS.key(resolved(topic)) for topic in TOPICS if topic.name not in mine]
    heard: list[str] = []
    last, last_one = Event(), last_key()
    attachment = Attachment(1, 1, bytes(16)).pack()
    logger, liar = clients["logger"], clients[name]
    with ExitStack() as stack:
        for key in keys:
            stack.callback(
                logger.declare_subscriber(key, lambda sample: heard.append(str(sample.key_expr))).undeclare
            )
            stack.callback(
                logger.declare_subscriber(
                    f"{key}/@adv/**", lambda sample: heard.append(str(sample.key_expr))
                ).undeclare
            )
        stack.callback(logger.declare_subscriber(last_one, lambda _: last.set()).undeclare)
        for number in range(10_000):
            key = keys[number % len(keys)]
            if number % 3 == 0:
                liar.put(key, b"forged", attachment=attachment)
            elif number % 3 == 1:
                liar.put(f"{key}/@adv/pub/{'a' * 16}/1/_", b"forged")
            else:
                liar.delete(key)
        for _ in range(600):
            liar.put(last_one, "last")
            if last.wait(0.1):
                break
        assert last.is_set()
    assert heard == []


def test_nobody_can_pose_as_anothers_node_or_publisher(clients):
    seen: set[str] = set()
    last = Event()

    def take(token: zenoh.Sample) -> None:
        seen.add(str(token.key_expr))
        if "/view/" in str(token.key_expr):
            last.set()

    with ExitStack() as stack:
        watcher = (
            clients["logger"]
            .liveliness()
            .declare_subscriber("@ros2_lv/0/*/*/*/MP/*/*/*/*/*/*/*", take, history=True)
        )
        stack.callback(watcher.undeclare)
        session = clients["view"]
        topic = next(topic for topic in TOPICS if topic.name == "estimate/odometry")
        diagnostics = next(topic for topic in TOPICS if topic.name == "diagnostics")
        for node, of in (
            ("estimator", topic),
            ("view", topic),
            ("estimator", diagnostics),
            ("view", diagnostics),
        ):
            key = GraphNode(KEYS, str(session.zid()), node).endpoint_token("MP", 7, of)
            stack.callback(session.liveliness().declare_token(key).undeclare)
        assert last.wait(TIMEOUT_S)
    assert {key.split("/", 8)[8].split("/", 2)[1] for key in seen} == {"%diagnostics"}
    assert all("/view/" in key for key in seen)


# --- control ---


def served(session: zenoh.Session, key: str, answer: str, asked: list[str]) -> zenoh.Queryable:
    def reply(query: zenoh.Query) -> None:
        with query:
            asked.append(str(query.key_expr))
            query.reply(query.key_expr, answer)

    return session.declare_queryable(key, reply)


def await_served(session: zenoh.Session, key: str) -> None:
    """Wait until a queryable is known; others that were declared before it are known then too."""
    assert any(answers(session, key) for _ in range(100))


def answers(session: zenoh.Session, key: str, timeout_s: float = 0.3) -> list[str]:
    """Return the answers to a query; it waits for as long only where none comes."""
    replies = session.get(key, target=zenoh.QueryTarget.ALL, timeout=timeout_s)
    return [reply.ok.payload.to_string() for reply in replies if reply.ok]


@pytest.mark.parametrize("name", sorted(EVERYBODY))
def test_only_an_operator_gives_commands_and_only_under_its_own_name(clients, name):
    asked: list[str] = []
    queryable = served(clients["estimator"], "0/rpod/estimator/reset/by/*", "done", asked)
    await_served(clients["operator"], "0/rpod/estimator/reset/by/operator")
    asked.clear()
    key, patient_s = "0/rpod/estimator/reset/by/", TIMEOUT_S if name == "operator" else 0.3
    got = [answers(clients[name], f"{key}{by}", patient_s) for by in (name, "operator")]
    got += [answers(clients[name], f"{key}{by}") for by in ("*", "**")]
    queryable.undeclare()
    if name == "estimator":
        return  # a session answers itself, whatever the router allows
    if name == "operator":
        assert got == [["done"], ["done"], [], []]
        assert asked == ["0/rpod/estimator/reset/by/operator"] * 2
    else:
        assert got == [[], [], [], []]
        assert asked == []


@pytest.mark.parametrize("name", sorted(EVERYBODY - {"motion", "operator"}))
def test_a_role_that_may_not_serve_a_verb_gets_no_query_of_it(clients, name):
    asked: list[str] = []
    wrong = served(clients[name], "0/rpod/motion/start/by/*", "forged", asked)
    alike = served(clients[name], f"0/rpod/{name}/nonsense/by/*", "forged", asked)
    everything = served(clients[name], "**", "forged", asked)
    known = served(clients[name], f"0/rpod/{name}/shutdown/by/*", "yes", [])
    await_served(clients["operator"], f"0/rpod/{name}/shutdown/by/operator")
    known.undeclare()
    asked.clear()  # a session gives a query to all its queryables
    got = answers(clients["operator"], "0/rpod/motion/start/by/operator")
    for queryable in (wrong, alike, everything):
        queryable.undeclare()
    assert (got, asked) == ([], [])


def test_a_ros_service_is_between_the_two_that_the_configuration_names(clients):
    key = "0/set_mode/std_srvs::srv::dds_::SetBool_/RIHS01_0"
    asked: list[str] = []
    queryable = served(clients["estimator"], key, "done", asked)
    await_served(clients["operator"], key)
    got = {name: answers(clients[name], key) for name in ("guidance", "view")}
    got["operator"] = answers(clients["operator"], key, TIMEOUT_S)
    queryable.undeclare()
    assert got == {"operator": ["done"], "guidance": [], "view": []}
    other = served(clients["view"], "0/other/std_srvs::srv::dds_::SetBool_/RIHS01_0", "forged", asked)
    assert not answers(clients["operator"], "0/other/std_srvs::srv::dds_::SetBool_/RIHS01_0")
    other.undeclare()
