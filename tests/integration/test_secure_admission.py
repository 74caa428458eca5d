"""Who gets onto a secure bus: certificates, and what an operator is told where one is refused."""

from datetime import timedelta
from pathlib import Path
from threading import Event
from time import monotonic

import pytest
import zenoh
from live_bus import TIMEOUT_S
from secure_bus import KEYS, SecureBus, secure_bus

from rpod.doctor import bus as doctor
from rpod.doctor.finding import Level
from rpod_runtime import Inbox, Node, QueryFailedError
from rpod_runtime.bus.refusal import refusal_in
from rpod_runtime.bus.session import free_endpoint, open_client, open_router
from rpod_runtime.errors import NotThisServiceError, RefusedByRouterError
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.control import Accepted, Empty, StatusReply
from rpod_schemas.messages import read_diagnostics
from rpod_schemas.topics import DIAGNOSTICS, STATUS
from rpod_schemas.types import Health
from rpod_security.audit import check
from rpod_security.credentials import AUDIT
from rpod_security.errors import CredentialsError, RulesError


@pytest.fixture(scope="module")
def bus(tmp_path_factory):
    with secure_bus(tmp_path_factory.mktemp("admission")) as bus:
        yield bus


def refusal(config: BusConfig) -> str:
    """Return the line for a client that is refused; how long it takes depends on the machine."""
    with pytest.raises(RefusedByRouterError) as refused:
        open_client(config.model_copy(update={"connect_timeout_s": TIMEOUT_S}))
    return str(refused.value)


def test_an_interloper_on_plain_tcp_is_refused_at_once_with_the_remedy(bus: SecureBus):
    text = refusal(BusConfig(connect=bus.endpoint.replace("tls/", "tcp/")))
    assert "it is a secure bus" in text
    assert "bus.credentials" in text


def test_a_certificate_of_another_authority_is_refused(bus: SecureBus, tmp_path: Path):
    text = refusal(bus.stranger(tmp_path, "motion", "motion"))
    assert "not of the authority in bus.credentials" in text


def test_a_forged_certificate_with_the_right_authority_beside_it_cannot_be_used(
    bus: SecureBus, tmp_path: Path
):
    forged = bus.stranger(tmp_path, "motion", "motion").credentials
    assert forged
    (forged / "authority.pem").write_bytes((bus.pki / "motion" / "authority.pem").read_bytes())
    with pytest.raises(CredentialsError, match="not of its authority"):
        open_client(BusConfig(connect=bus.endpoint, credentials=forged))


def test_an_expired_certificate_is_refused_with_the_remedy(bus: SecureBus):
    bus.authority.renew("lamp", validity=timedelta(seconds=-1))
    text = refusal(bus.bus("lamp"))
    assert "has expired" in text
    assert "rpod pki renew" in text
    bus.authority.renew("lamp")
    bus.client("lamp").close()


def test_a_client_that_shows_no_certificate_is_refused(bus: SecureBus):
    endpoint = f'{{"endpoints": ["{bus.endpoint}"], "timeout_ms": 0}}'
    config = zenoh.Config.from_json5(
        f'{{mode: "client", connect: {endpoint}, scouting: {{multicast: {{enabled: false}}}}, '
        f'transport: {{link: {{tls: {{root_ca_certificate: "{bus.pki / "motion" / "authority.pem"}"}}}}}}}}'
    )
    with pytest.raises(zenoh.ZError):
        zenoh.open(config)


def test_the_routers_certificate_is_no_clients(bus: SecureBus):
    with pytest.raises(RefusedByRouterError):
        open_client(bus.bus("router"))


def test_a_clients_certificate_makes_no_router(bus: SecureBus):
    config = bus.router_config().model_copy(
        update={"credentials": bus.pki / "lamp", "listen": "tls/127.0.0.1:0"}
    )
    with secure_router(config) as endpoint, pytest.raises(RefusedByRouterError):
        open_client(bus.bus("motion").model_copy(update={"connect": endpoint}))


class secure_router:  # noqa: N801 - used as a function
    """A router with any configuration, on a free port."""

    def __init__(self, config) -> None:
        self._endpoint = free_endpoint().replace("tcp/", "tls/")
        self._config = config.model_copy(update={"listen": self._endpoint})

    def __enter__(self) -> str:
        self._session = open_router(self._config)
        return self._endpoint

    def __exit__(self, *_: object) -> None:
        self._session.close()


def test_a_router_at_another_address_than_its_certificate_names_is_not_believed(bus: SecureBus):
    address = bus.endpoint.replace("127.0.0.1", "127.0.0.2")
    bus.authority.issue("router", "elsewhere", hosts=("elsewhere.example",))
    config = bus.router_config().model_copy(update={"credentials": bus.pki / "elsewhere"})
    with secure_router(config) as endpoint:
        text = refusal(bus.bus("motion").model_copy(update={"connect": endpoint}))
    assert "not for this address" in text
    assert address


def test_a_revoked_name_has_no_rights_after_new_rules_and_its_successor_has(bus: SecureBus, tmp_path: Path):
    old = tmp_path / "old"
    old.mkdir(mode=0o700)
    for file in (bus.pki / "view").iterdir():
        (old / file.name).write_bytes(file.read_bytes())
        (old / file.name).chmod(0o600)
    bus.authority.revoke("view")
    bus.write_rules()
    assert allowed(bus, old) == 0
    bus.authority.issue("view", "view")
    bus.write_rules()
    assert allowed(bus, old) == 0
    assert allowed(bus, bus.pki / "view") > 0


def allowed(bus: SecureBus, credentials: Path) -> int:
    """Return how many messages a router with today's rules delivers to a viewer and from it."""
    delivered: list[str] = []
    done = Event()
    with secure_router(bus.router_config()) as endpoint:
        both = {"connect": endpoint}
        key = KEYS.key(DIAGNOSTICS)
        with (
            open_client(bus.bus("view").model_copy(update=both | {"credentials": credentials})) as view,
            open_client(bus.bus("logger").model_copy(update=both)) as logger,
            open_client(bus.bus("motion").model_copy(update=both)) as motion,
        ):

            def take(sample: zenoh.Sample) -> None:
                text = sample.payload.to_string()
                if text == "to all":
                    done.set()
                else:
                    delivered.append(text)

            def take_other(sample: zenoh.Sample) -> None:
                if sample.payload.to_string() == "to all":
                    delivered.append("to view")

            subscribers = [view.declare_subscriber(key, take_other), logger.declare_subscriber(key, take)]
            for _ in range(1200):
                view.put(key, "of view")
                motion.put(key, "to all")
                if done.wait(0.05):
                    break
            assert done.is_set()
            for subscriber in subscribers:
                subscriber.undeclare()
    return len(delivered)


# --- services ---


def test_credentials_of_another_name_are_refused(bus: SecureBus):
    with pytest.raises(NotThisServiceError, match="those of 'view'"):
        Node(ServiceConfig(instance="logger", bus=bus.bus("view")), version="test")


@pytest.mark.parametrize("content", ["{}", "no json", '{"enabled": true, "default_permission": "allow"}'])
def test_a_router_takes_no_rules_that_do_not_deny_by_default(bus: SecureBus, tmp_path: Path, content: str):
    rules = tmp_path / "rules.json"
    rules.write_text(content)
    with pytest.raises(RulesError, match="rpod pki rules"):
        open_router(bus.router_config().model_copy(update={"rules": rules}))


def test_who_asks_stands_in_the_audit_record_and_in_the_diagnostics(bus: SecureBus):
    told: dict[str, str] = {}
    seen = Event()

    def take(received) -> None:
        for diagnostic in read_diagnostics(received.decode()):
            if "command_by/reset" in diagnostic.values:
                told.update(diagnostic.values)
                seen.set()

    with bus.node("estimator") as estimator, bus.node("operator") as operator:
        estimator.serve("reset", Empty, lambda _: Accepted())
        operator.subscribe(DIAGNOSTICS, take)
        assert operator.ask("estimator", "reset", Accepted, timeout_s=TIMEOUT_S).accepted
        assert operator.ask("estimator", "status", StatusReply).name == "estimator"
        with bus.node("guidance") as guidance, pytest.raises(QueryFailedError):
            guidance.ask("estimator", "reset", Accepted, timeout_s=0.2)
        assert seen.wait(TIMEOUT_S)
    assert told["command_by/reset"] == "operator"
    record = bus.pki / "estimator" / AUDIT
    assert check(record) == 2
    assert '"role": "operator", "verb": "reset"' in record.read_text()


def test_status_tells_nothing_of_keys(bus: SecureBus):
    with bus.node("estimator"), bus.node("operator") as operator:
        reply = operator.ask("estimator", "status", StatusReply)
    secret = (bus.pki / "estimator" / "identity.pem").read_text().split("PRIVATE KEY")[1]
    assert secret.split()[1] not in reply.model_dump_json()


@pytest.mark.parametrize(
    ("name", "level", "text"),
    [
        ("operator", Level.FAIL, "rpod test; here is"),
        ("guidance", Level.UNCHECKED, "none answers to guidance"),
    ],
)
def test_the_doctor_asks_by_the_name_of_its_certificate(bus: SecureBus, name: str, level: Level, text: str):
    with bus.node("estimator"):
        *_, services = doctor.link(bus.bus(name, wait=False))
    assert services.level is level
    assert text in services.text


def test_a_certificate_that_ends_soon_is_in_the_diagnostics_until_it_is_renewed(bus: SecureBus):
    bus.authority.renew("chaser", validity=timedelta(days=29))
    inbox = Inbox()

    def levels() -> Health:
        for _ in range(40):
            for received in inbox.wait(0.5):
                for diagnostic in read_diagnostics(received.decode()):
                    if diagnostic.name == "chaser":
                        return diagnostic.level, diagnostic.values.get("certificate", "")
        raise AssertionError("no diagnostics")

    with bus.node("operator") as operator, bus.node("chaser") as chaser:
        operator.subscribe(DIAGNOSTICS, inbox.put)
        chaser.ready("measuring")
        level, text = levels()
        assert level == Health.WARN
        assert "expires in 28 days" in text
        assert "rpod pki renew chaser" in text
        bus.authority.renew("chaser")
        for _ in range(20):
            level, text = levels()
            if not text:
                break
        assert (level, text) == (Health.OK, "")


def test_commands_of_one_asker_are_bounded(bus: SecureBus):
    done: list[int] = []
    with bus.node("logger") as logger, bus.node("operator") as operator:

        def stop(_: Empty) -> Accepted:
            done.append(1)
            return Accepted()

        logger.serve("stop", Empty, stop)
        refused = 0
        begin_s = monotonic()
        for _ in range(300):
            try:
                operator.ask("logger", "stop", Accepted, timeout_s=TIMEOUT_S)
            except QueryFailedError as error:
                refused += "ask less often" in str(error)
        took_s = monotonic() - begin_s
    assert len(done) <= 40 + 20 * took_s + 1
    assert len(done) + refused == 300


def test_a_services_data_come_through_with_history(bus: SecureBus):
    inbox = Inbox()
    with bus.node("estimator") as estimator:
        publisher = estimator.publisher(STATUS)
        publisher.put(b"\0\1\0\0first")
        with bus.node("logger") as logger:
            logger.subscribe(STATUS, inbox.put, recover=True, history=True)
            got = inbox.wait(TIMEOUT_S)
            publisher.put(b"\0\1\0\0second")  # with the reply still under way, Zenoh may drop the history
            got += inbox.wait(TIMEOUT_S)
    assert [received.attachment.sequence for received in got] == [1, 2]


@pytest.mark.parametrize(
    ("line", "meaning"),
    [
        ("received corrupt message of type InvalidContentType. Hint: increase the", "uses no TLS"),
        ("invalid peer certificate: certificate expired: verification time 1", "has expired"),
        ("invalid peer certificate: BadSignature.", "another authority"),
        ("peer sent no certificates.", "shows no certificate"),
    ],
)
def test_the_routers_operator_reads_why_a_client_was_refused(line: str, meaning: str):
    assert meaning in refusal_in(f"WARN acc-0 zenoh_link_tls::unicast: {line}")
    assert not refusal_in(f"WARN zenoh::net: {line}")
