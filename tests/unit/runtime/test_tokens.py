from rpod_runtime.bus import tokens
from rpod_runtime.bus.tokens import LONGEST_TOKEN, PublisherTokens
from rpod_schemas.rmw.wire import GraphNode
from rpod_schemas.topics import CLOCK, DIAGNOSTICS, Namespace, Topic

KEYS = Namespace()


def token(topic: Topic, *, session: str = "a1", node: str = "motion", entity: int = 1) -> str:
    return GraphNode(KEYS, session, node).endpoint_token("MP", entity, topic)


class Watch:
    def __init__(self) -> None:
        self.came: list[tuple[str, str]] = []
        self.gone: list[tuple[str, str]] = []
        self._tokens = PublisherTokens(
            KEYS,
            came=lambda session, topic: self.came.append((session, topic.name)),
            gone=lambda session, topic: self.gone.append((session, topic.name)),
        )

    def take(self, each: str, *, comes: bool) -> None:
        self._tokens.take(each, comes)


def test_a_publisher_is_gone_with_its_last_token_whoever_declared_the_others():
    watch = Watch()
    own, forged = token(DIAGNOSTICS), token(DIAGNOSTICS, node="liar")
    for each in (own, forged, token(CLOCK)):
        watch.take(each, comes=True)
    watch.take(forged, comes=False)
    assert watch.gone == []
    watch.take(own, comes=False)
    assert watch.gone == [("a1", "diagnostics")]
    assert watch.came == [("a1", "diagnostics")] * 2 + [("a1", "clock")]


def test_a_publisher_that_comes_again_can_be_gone_again():
    watch = Watch()
    for comes in (True, False, True, True, False):
        watch.take(token(CLOCK), comes=comes)
    assert watch.gone == [("a1", "clock")] * 2


def test_tokens_without_end_are_bounded_and_those_that_are_not_remembered_count_at_once(monkeypatch):
    monkeypatch.setattr(tokens, "MOST_TOKENS", 2)
    watch = Watch()
    for entity in range(4):
        watch.take(token(CLOCK, session=f"a{entity}"), comes=True)
    watch.take(token(CLOCK, session="a3"), comes=False)
    watch.take(token(CLOCK, session="a0"), comes=False)
    watch.take(token(CLOCK, session="a2"), comes=True)  # there is room again
    watch.take(token(CLOCK, session="a2", node="liar"), comes=False)
    assert watch.gone == [("a3", "clock"), ("a0", "clock")]


def test_tokens_of_others_and_those_that_are_too_long_are_left_out():
    watch = Watch()
    watch.take(token(CLOCK).replace("clock", "x" * LONGEST_TOKEN), comes=True)
    elsewhere = GraphNode(Namespace(0, "lab"), "a1", "motion").endpoint_token("MP", 1, CLOCK)
    watch._tokens._keys = Namespace(0, "hall")
    watch.take(elsewhere, comes=True)
    assert watch.came == []
