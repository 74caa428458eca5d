import logging
import os

from rpod_runtime.bus.refusal import _log_lines


def test_a_client_that_fails_in_unknown_ways_without_end_writes_no_lines_without_end(caplog):
    reader, writer = os.pipe()
    known = "WARN acc-0 zenoh_link_tls::unicast: peer sent no certificates.\n"
    unknown = "WARN acc-0 zenoh_link_tls::unicast: received fatal alert: HandshakeFailure\n"
    with os.fdopen(writer, "w") as stream:
        stream.write("INFO zenoh::net: something else\n" + 50 * (unknown + known))
    with caplog.at_level(logging.INFO):
        _log_lines(reader)
    assert [record.getMessage() for record in caplog.records] == [
        "INFO zenoh::net: something else",
        f"{unknown.rstrip()} (1 so far)",
        "refused a client: it shows no certificate (1 so far)",
    ]
