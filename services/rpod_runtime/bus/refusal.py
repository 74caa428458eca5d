"""Reasons why a router refuses a client: from a TLS handshake by Python, and from the router's log lines.

Zenoh tells a client only that it cannot connect, and tells the router's operator of "corrupt messages".
"""

import logging
import os
import re
import socket
import ssl
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Thread

import zenoh

from rpod_schemas.config.service import BusConfig

log = logging.getLogger(__name__)

_TIMEOUT_S = 0.4
"""Time for each step of the handshake, s; on a network it takes some milliseconds."""
_REMIND_S = 60.0
_RENEW = "'rpod pki renew' replaces it"
_REASONS = (
    ("wrong.version.number|record layer", "it uses plain TCP, so bus.connect has to begin with tcp/"),
    ("unknown ca|decrypt error|bad certificate", "it does not trust the authority of this certificate"),
    ("certificate required", "it wants a certificate; give bus.credentials"),
    ("alert certificate expired", f"the certificate of this client has expired; {_RENEW}"),
    ("has expired", f"the router's certificate has expired; {_RENEW}"),
    ("mismatch|not valid for", "its certificate is not for this address; 'rpod pki init --host' names it"),
    ("not yet valid", "a certificate is not valid yet; are the clocks of both hosts right?"),
    ("verify failed", "its certificate is not of the authority in bus.credentials"),
)
"""Texts of OpenSSL, as patterns, and what they mean to a client."""
_KINDS = (
    ("InvalidContentType|corrupt message", "it uses no TLS; clients need tls/... and credentials"),
    ("certificate expired|Expired", f"its certificate has expired; {_RENEW}"),
    ("UnknownIssuer|BadSignature|BadEncoding", "its certificate is of another authority"),
    ("no certificates|NoCertificatesPresented|CertificateRequired", "it shows no certificate"),
    ("InvalidPurpose", "its certificate is not that of a client"),
    ("eof|timed? ?out|reset", "it did not finish the handshake"),
)
"""Log lines of Zenoh's TLS link, as patterns, and what they mean to the router's operator."""
_TLS = "zenoh_link_tls"
_LONGEST_LINE = 1000
"""Largest number of characters of a line that is logged as it is."""


def why_refused(bus: BusConfig) -> str:
    """Return why the router at an endpoint refuses this client; empty if there is none or nothing is known.

    It takes at most 0.8 s.
    """
    protocol, _, address = bus.connect.partition("/")
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    if protocol not in ("tcp", "tls") or not port.isdigit():
        return ""
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=_TIMEOUT_S) as link:
            if protocol == "tls":
                return _refusal(bus, link, host)
            return _answers_tls(link)
    except (OSError, ValueError):  # nobody listens, or it is not known why
        return ""


def _answers_tls(link: socket.socket) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with context.wrap_socket(link):
        return "it is a secure bus: bus.connect has to begin with tls/, and bus.credentials are needed"


def _refusal(bus: BusConfig, link: socket.socket, host: str) -> str:
    from rpod_security.credentials import AUTHORITY, IDENTITY  # noqa: PLC0415 - of an extra

    if bus.credentials is None:
        return ""
    context = ssl.create_default_context(cafile=bus.credentials / AUTHORITY)
    context.load_cert_chain(bus.credentials / IDENTITY)
    try:
        with context.wrap_socket(link, server_hostname=host) as secured, suppress(TimeoutError):
            secured.recv(1)  # in TLS 1.3 the server checks the client's certificate after the handshake
    except ssl.SSLError as error:
        text = str(error).lower()
        found = (meaning for pattern, meaning in _REASONS if re.search(pattern, text.replace("_", " ")))
        return next(found, f"the handshake fails: {error.reason or error}")
    return ""


@contextmanager
def telling_refusals() -> Iterator[None]:
    """Log in plain words which clients this process's router refuses, one line a minute for each reason.

    Zenoh writes its own lines to standard output, so standard output is a pipe meanwhile. Lines that are not
    understood are logged as they are, those about TLS once a minute.
    """
    reader, writer = os.pipe()
    before = os.dup(1)
    os.dup2(writer, 1)
    os.close(writer)
    zenoh.init_log_from_env_or("zenoh_link_tls=warn")
    thread = Thread(target=_log_lines, args=(reader,), name="refusals", daemon=True)
    thread.start()
    try:
        yield
    finally:
        os.dup2(before, 1)  # closes the pipe, which ends the thread
        os.close(before)
        thread.join(1.0)


def _log_lines(reader: int) -> None:
    counts: Counter[str] = Counter()
    told_s: dict[str, float] = {}
    with open(reader, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            kind = refusal_in(line)
            text = f"refused a client: {kind}" if kind else line.rstrip()[:_LONGEST_LINE]
            if _TLS not in line:
                log.info("%s", text)
                continue
            counts[kind] += 1  # a client can fail in ways that are not known here, too
            if time.monotonic() - told_s.get(kind, -_REMIND_S) >= _REMIND_S:
                told_s[kind] = time.monotonic()
                log.warning("%s (%d so far)", text, counts[kind])


def refusal_in(line: str) -> str:
    """Return what a line of Zenoh's log means to the operator; empty if it tells of no refused client."""
    if _TLS not in line:
        return ""
    return next((meaning for pattern, meaning in _KINDS if re.search(pattern, line)), "")
