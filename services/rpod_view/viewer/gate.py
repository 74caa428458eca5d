"""The login in front of a web viewer that other machines can reach.

Rerun's servers have no login, so they listen on this machine alone. The gate passes on the requests of a
browser that has given the token, and nothing else. Page and data come from one port, because a browser sends
its cookie only to the address that has set it. The token stands in a file, never in an address, a log line or
a process argument. The connection is not encrypted: an SSH tunnel is better where others read the network.
"""

import hmac
import logging
import os
import secrets
import select
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPException, HTTPResponse
from pathlib import Path
from threading import BoundedSemaphore, Thread
from typing import Any
from urllib.parse import quote

from werkzeug.exceptions import HTTPException as Refusal
from werkzeug.serving import ThreadedWSGIServer, WSGIRequestHandler
from werkzeug.wrappers import Request, Response

from rpod_schemas.config.facility.view import ViewConfig
from rpod_view.errors import GateError

log = logging.getLogger(__name__)

_COOKIE = "rpod_view"
_TOKEN_BYTES = 24
"""Random bytes of a token that is made here."""
_LEAST_CHARACTERS = 16
"""Least length of a token that a user has written."""
_MOST_CONNECTIONS = 64
"""Largest number of connections at a time; a browser opens six."""
_SILENT_S = 60.0
"""Time without data after which a connection is closed, s."""
_WATCH_S = 1.0
"""Time without data from a server after which it is checked whether the browser is still there, s."""
_MOST_BYTES = 1 << 16
"""Largest request: a browser sends a question of some bytes, and never data."""
_CHUNK_BYTES = 1 << 16
"""Most bytes that are passed on at once."""
_DATA, _WRITING = "/rerun.", "/Write"
"""Beginning of the path of each request for Rerun's data, and the part that only writing requests contain."""
_OWN_LINK = {"connection", "keep-alive", "transfer-encoding", "content-length", "date", "server"}
"""Headers that belong to one link and are not passed on."""
_LOGIN = """<!doctype html><title>rpod view</title>
<form method="post" action="/login"><label>Token <input name="token" type="password" autofocus></label>
<button>Show</button></form><p>The token stands in the file that the view's log line names.</p>"""


def read_token(file: Path) -> str:
    """Return the token in a file, which is made, readable by its owner alone, if it is not there.

    Raises:
        GateError: the file cannot be used.
    """
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    except FileExistsError:
        return _existing(file)
    except OSError as error:
        raise GateError(file, f"cannot be made ({error.strerror})", "give another token_file") from error
    token = secrets.token_urlsafe(_TOKEN_BYTES)
    with os.fdopen(descriptor, "w", encoding="ascii") as stream:
        stream.write(token + "\n")
    return token


def _existing(file: Path) -> str:
    try:
        mode, token = stat.S_IMODE(file.stat().st_mode), file.read_text("ascii").strip()
    except (OSError, ValueError) as error:
        raise GateError(file, f"cannot be read ({error})", "remove it, and a new one is made") from error
    if mode & 0o077:
        raise GateError(file, f"can be read by others (mode {mode:o})", f"'chmod 600 {file}'")
    if len(token) < _LEAST_CHARACTERS:
        raise GateError(
            file,
            f"holds {len(token)} characters, {_LEAST_CHARACTERS} are needed",
            "remove it, and a new one is made",
        )
    return token


class Gate:
    """Answers a browser: passes on to the servers behind it, or asks for the token. A WSGI application.

    Args:
        token: what the operator has to give.
        page_port: port of Rerun's page, on loopback.
        data_port: port of Rerun's data, on loopback.
    """

    def __init__(self, token: str, *, page_port: int, data_port: int) -> None:
        self._token, self._page_port, self._data_port = token, page_port, data_port
        self._session = secrets.token_urlsafe(32)

    def __call__(self, environ: Any, start_response: Any) -> Any:
        """Answer one request; one that cannot be read is refused with its status."""
        request = Request(environ)
        request.max_content_length = request.max_form_memory_size = _MOST_BYTES
        try:
            answer = self._answer(request)
        except Refusal as refusal:
            return refusal(environ, start_response)
        return answer(environ, start_response)

    def _answer(self, request: Request) -> Response:
        if request.path == "/login" and request.method == "POST":
            return self._log_in(request)
        if not _same(request.cookies.get(_COOKIE, ""), self._session):
            return Response(_LOGIN, 401, content_type="text/html")
        if _WRITING in request.path or request.method not in ("GET", "POST"):
            return Response("this view is read-only: nothing can be written to it\n", 403)
        if request.path == "/" and "url" not in request.args:
            return _to_page(request)
        return self._pass_on(request)

    def _log_in(self, request: Request) -> Response:
        if not _same(request.form.get("token", "").strip(), self._token):
            log.warning("%s gave a wrong token", request.remote_addr)
            return Response(_LOGIN, 401, content_type="text/html")
        log.info("%s gave the token and is shown the view", request.remote_addr)
        answer = _to_page(request)
        answer.set_cookie(_COOKIE, self._session, httponly=True, samesite="Strict")
        return answer

    def _pass_on(self, request: Request) -> Response:
        port = self._data_port if request.path.startswith(_DATA) else self._page_port
        headers = {name: text for name, text in request.headers if name.lower() not in {*_OWN_LINK, "cookie"}}
        target = quote(request.path, safe="/.") + ("?" + request.query_string.decode("latin-1")).rstrip("?")
        link = _Link(port, request.environ["werkzeug.socket"])
        try:
            link.request(request.method, target, body=request.get_data(), headers=headers)
            found = link.getresponse()
        except (OSError, HTTPException):
            link.close()
            return Response("the viewer does not answer; try again\n", 502)
        kept = [(name, text) for name, text in found.getheaders() if name.lower() not in _OWN_LINK]
        answer = Response(_stream(found), found.status, headers=kept)
        answer.call_on_close(found.close)
        answer.call_on_close(link.close)
        return answer


class _Link(HTTPConnection):
    """A connection to a server behind the gate; it ends when the browser's connection has ended.

    Args:
        port: port of the server, on loopback.
        browser: the browser's connection.
    """

    def __init__(self, port: int, browser: socket.socket) -> None:
        super().__init__("127.0.0.1", port, timeout=_WATCH_S)
        self._browser = browser

    def connect(self) -> None:
        """Connect to the server."""
        super().connect()
        self.sock = _Watching(self.sock, self._browser)


class _Watching(socket.socket):
    """Takes over a connected socket; while it waits for data, it watches the browser's connection."""

    def __init__(self, connected: socket.socket, browser: socket.socket) -> None:
        timeout_s = connected.gettimeout()
        super().__init__(fileno=connected.detach())
        self.settimeout(timeout_s)
        self._browser = browser

    def recv_into(self, *args: Any) -> int:
        """Receive data; raise ``ConnectionAbortedError`` when the browser has closed its connection."""
        while True:
            try:
                return super().recv_into(*args)
            except TimeoutError:
                if _is_closed(self._browser):
                    raise ConnectionAbortedError("the browser has gone") from None


def _is_closed(browser: socket.socket) -> bool:
    watched = select.poll()  # select takes no descriptor above 1,023
    watched.register(browser, select.POLLIN)
    return bool(watched.poll(0)) and not browser.recv(1, socket.MSG_PEEK)


def _stream(found: HTTPResponse) -> Iterator[bytes]:
    """Yield what comes as soon as it comes: the data of a live view have no end."""
    while data := found.read1(_CHUNK_BYTES):
        yield data


def _same(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode(), wanted.encode())


def _to_page(request: Request) -> Response:
    """Return the way to the page, which asks for its data at the same address."""
    data = quote(f"rerun+http://{request.host}/proxy", safe="")
    return Response(status=303, headers={"Location": f"/?url={data}"})


class _Server(ThreadedWSGIServer):
    """Serves each connection in a thread of its own, up to ``_MOST_CONNECTIONS`` at a time."""

    daemon_threads = True

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._free = BoundedSemaphore(_MOST_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection, or close it if there are too many."""
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except RuntimeError as error:  # the machine has no room for one more thread
            self._free.release()
            self.shutdown_request(request)
            log.error("a connection of %s is closed: %s", client_address[0], error)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection to its end."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()


class _Handler(WSGIRequestHandler):
    timeout = _SILENT_S

    def log(self, type: str, message: str, *args: Any) -> None:  # noqa: A002 - named by the base class
        """Log nothing: addresses that a browser sends may be confidential."""


@contextmanager
def open_gate(config: ViewConfig, token_file: Path, *, page_port: int, data_port: int) -> Iterator[str]:
    """Open the gate at ``bind`` and ``web_port`` of a configuration; yields its address.

    Raises:
        GateError: the file of the token cannot be used.
        OSError: the address cannot be listened on.
    """
    gate = Gate(read_token(token_file), page_port=page_port, data_port=data_port)
    family = socket.AF_INET if config.bind.version == 4 else socket.AF_INET6
    with socket.create_server((str(config.bind), config.web_port), family=family) as listener:
        server = _Server(str(config.bind), config.web_port, gate, _Handler, fd=listener.fileno())
        thread = Thread(target=server.serve_forever, name="gate", daemon=True)
        thread.start()
        try:
            host = str(config.bind) if config.bind.version == 4 else f"[{config.bind}]"
            yield f"http://{host}:{listener.getsockname()[1]}/"
        finally:
            server.shutdown()
            thread.join()
            server.server_close()
