"""The truth is kept from estimators: by the shipped rules of the router, and by what their code names."""

import ast
import tomllib
from contextlib import ExitStack
from pathlib import Path
from threading import Event

import numpy as np
import pytest
import zenoh
import zenoh.ext
from live_bus import TIMEOUT_S, collect

from rpod_runtime import Inbox
from rpod_runtime.bus.session import open_client
from rpod_schemas.config.service import ESTIMATOR_ID, BusConfig
from rpod_schemas.messages import write_joints, write_odometry, write_transforms, write_vector_stamped
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.topics import REFERENCE, SUN, TF, TRUTH, TRUTH_JOINTS, TRUTH_TOPICS, Namespace, Topic
from rpod_schemas.types import Joints, Odometry

ROOT = Path(__file__).parents[2]
ODOMETRY = write_odometry(
    Odometry(
        stamp_ns=1,
        frame_id="chaser",
        child_frame_id="target",
        pose=make_pose(),
        linear_m_s=np.zeros(3),
        angular_rad_s=np.zeros(3),
    )
)
MESSAGES = {
    TRUTH: ODOMETRY,
    TRUTH_JOINTS: write_joints(Joints(stamp_ns=1, angle_rad={"array": 0.5}, rate_rad_s={"array": 0.0})),
    REFERENCE: ODOMETRY,
    TF: write_transforms(1, [("chaser", "target", make_pose())]),
}
DENIED = {topic.name for topic in TRUTH_TOPICS}
SENTINEL = write_vector_stamped(2, "chaser", np.zeros(3))


class Ears:
    """A bare client that notes the topics it hears, caches' keys included; the sun is sent last."""

    def __init__(self, session: zenoh.Session, keys: Namespace) -> None:
        self._session, self._keys = session, keys
        self.heard: set[str] = set()
        self.sun = Event()

    def __call__(self, sample: zenoh.Sample) -> None:
        topic = self._keys.topic_of(str(sample.key_expr).split("/@adv/")[0])
        self.heard.add(topic)
        if topic == SUN.name:
            self.sun.set()

    def query(self, selector: str) -> list[str]:
        answers = self._session.get(selector, target=zenoh.QueryTarget.ALL, timeout=TIMEOUT_S)
        return [str(answer.ok.key_expr) for answer in answers if answer.ok]


@pytest.fixture
def stack():
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def listen(bus, stack):
    def listen(*, estimator: bool, namespace: str = "") -> Ears:
        config = BusConfig(connect=bus.endpoint, namespace=namespace)
        session = stack.enter_context(open_client(config, zenoh_id=ESTIMATOR_ID if estimator else ""))
        return Ears(session, config.keys)

    return listen


def subscribe(ears: Ears, stack: ExitStack, *keys: str, history: bool = False) -> None:
    for key in keys:
        subscriber = (
            zenoh.ext.declare_advanced_subscriber(
                ears._session,
                key,
                ears,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=90),
                recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            )
            if history
            else ears._session.declare_subscriber(key, ears)
        )
        stack.callback(subscriber.undeclare)


class Truth:
    """Publishes everything that is denied, and last what is not."""

    def __init__(self, node) -> None:
        self._publishers = [(node.publisher(topic), message) for topic, message in MESSAGES.items()]
        self._publishers.append((node.publisher(SUN), SENTINEL))

    def publish(self) -> None:
        for publisher, message in self._publishers:
            publisher.publish(message)

    def publish_until_heard(self, viewer: Ears, estimator: Ears) -> None:
        """Publish until the viewer hears all of it; then once more, until the estimator hears the last."""
        for _ in range(200):
            viewer.sun.clear()
            self.publish()
            if viewer.sun.wait(0.05) and viewer.heard >= DENIED:
                break
        estimator.sun.clear()
        self.publish()
        assert estimator.sun.wait(TIMEOUT_S)
        assert viewer.heard >= DENIED


def exact(keys: Namespace) -> list[str]:
    return [keys.key(topic) for topic in (*TRUTH_TOPICS, SUN)]


WAYS = {
    "everything": lambda _: ["**"],
    "the exact keys": exact,
    "any type hash": lambda keys: [keys.selector(topic) for topic in (*TRUTH_TOPICS, SUN)],
    "the domain": lambda keys: [f"{keys.root}/**"],
}


@pytest.mark.parametrize("namespace", ["", "lab/east"])
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("history", [False, True], ids=["live", "with history"])
def test_an_estimator_hears_nothing_of_the_truth_by_subscribing(  # noqa: PLR0917 - fixtures
    bus, listen, stack, way, history, namespace
):
    estimator = listen(estimator=True, namespace=namespace)
    viewer = listen(estimator=False, namespace=namespace)
    for ears in (estimator, viewer):
        subscribe(ears, stack, *WAYS[way](Namespace(0, namespace)), history=history)
    Truth(bus.node("motion", namespace=namespace)).publish_until_heard(viewer, estimator)
    assert not estimator.heard & DENIED


def test_not_even_the_heartbeats_of_the_truths_caches_reach_an_estimator(bus, listen, stack):
    estimator, viewer = listen(estimator=True), listen(estimator=False)
    for ears in (estimator, viewer):
        subscribe(ears, stack, *(f"{key}/@adv/**" for key in exact(Namespace())))
    Truth(bus.node("motion")).publish()
    assert viewer.sun.wait(TIMEOUT_S)
    assert estimator.sun.wait(TIMEOUT_S)
    assert not estimator.heard & DENIED


@pytest.mark.parametrize("way", WAYS)
def test_an_estimator_that_joins_late_gets_no_truth_out_of_the_caches(bus, listen, stack, way):
    Truth(bus.node("motion")).publish()
    estimator, viewer = listen(estimator=True), listen(estimator=False)
    for ears in (viewer, estimator):
        subscribe(ears, stack, *WAYS[way](Namespace()), history=True)
        assert ears.sun.wait(TIMEOUT_S), "the latched sun comes out of its cache"
    assert not estimator.heard & DENIED


@pytest.mark.parametrize("topic", TRUTH_TOPICS, ids=lambda topic: topic.name)
@pytest.mark.parametrize(
    "selector", ["{key}", "{key}/@adv/**", "{key}/@adv/pub/**", "0/**/@adv/**", "**/@adv/**", "**"]
)
def test_an_estimator_gets_no_answer_with_truth(bus, listen, topic: Topic, selector):
    Truth(bus.node("motion")).publish()
    asked = selector.format(key=Namespace().key(topic)) + "?_anyke"
    assert not [key for key in listen(estimator=True).query(asked) if f"/{topic.name}/" in key]


def test_the_caches_answer_others(bus, listen):
    Truth(bus.node("motion")).publish()
    answers = listen(estimator=False).query(f"{Namespace().key(TRUTH)}/@adv/**?_anyke")
    assert any(f"/{TRUTH.name}/" in key for key in answers)


def test_an_estimator_may_say_where_it_sees_the_target(bus):
    """The rules deny what the estimator hears, not what it says: its own transform is on the same topic."""
    inbox = Inbox()
    bus.node("viewer").subscribe(TF, inbox.put)
    estimator = bus.node("estimator", zenoh_id=ESTIMATOR_ID)
    estimator.publisher(TF).put(encode(MESSAGES[TF]))
    assert len(collect(inbox, 1)) == 1


# --- by construction ---

FORBIDDEN_NAMES = {"TRUTH", "TRUTH_JOINTS", "REFERENCE", "TRUTH_TOPICS"}
MODULES = sorted((ROOT / "services" / "rpod_estimator").rglob("*.py"))


def names_in(tree: ast.AST) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.alias):
            found |= {node.name, node.name.rsplit(".", 1)[-1]}
    return found


def strings_in(tree: ast.AST) -> list[str]:
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docstrings = {ast.get_docstring(n, clean=False) for n in ast.walk(tree) if isinstance(n, documented)}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value not in docstrings
    ]


def calls_to(tree: ast.AST, *methods: str) -> list[ast.Call]:
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in methods
    ]


@pytest.mark.parametrize("module", MODULES, ids=lambda file: file.stem)
def test_no_module_of_the_estimator_names_the_truth(module):
    tree = ast.parse(module.read_text("utf-8"))
    assert not names_in(tree) & FORBIDDEN_NAMES
    assert not [text for text in strings_in(tree) if any(topic.name in text for topic in (TRUTH, REFERENCE))]


@pytest.mark.parametrize("module", MODULES, ids=lambda file: file.stem)
def test_no_module_of_the_estimator_subscribes_transforms_or_everything(module):
    tree = ast.parse(module.read_text("utf-8"))
    for call in calls_to(tree, "subscribe"):
        assert "TF" not in names_in(call)
    assert not calls_to(tree, "subscribe_all", "listen", "ask_all")
    assert not names_in(tree) & {"zenoh", "_session"}


def test_the_layers_forbid_the_estimator_to_import_the_motion():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layers,) = [
        contract["layers"]
        for contract in contracts
        if contract["type"] == "layers" and "containers" not in contract
    ]
    (services,) = [layer for layer in layers if "rpod_estimator" in layer]
    assert "rpod_motion" in services.split(" | "), "siblings by | may not import each other"
    for module in MODULES:
        imported = names_in(ast.parse(module.read_text("utf-8"))) | {
            str(node.module)
            for node in ast.walk(ast.parse(module.read_text("utf-8")))
            if isinstance(node, ast.ImportFrom)
        }
        assert not [name for name in imported if name.split(".")[0] in ("rpod_motion", "rpod_emulator")]
