"""Who gives the token sees the view, nobody else; a recording is only looked at."""

import re
import socket
import stat
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Event, Thread
from urllib.error import HTTPError
from urllib.parse import urlencode, urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

import pytest

from rpod_schemas.config.base import check
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.errors import ConfigurationError
from rpod_view.errors import GateError
from rpod_view.viewer import gate, viewer
from rpod_view.viewer.gate import open_gate, read_token


class Server(BaseHTTPRequestHandler):
    """Stands for one of Rerun's servers: says where it was asked."""

    protocol_version = "HTTP/1.1"
    name = ""
    left = Event()

    def do_GET(self):
        if self.path.endswith(("/silent", "/pausing")):
            self.say_a_part()
            return
        if self.path.endswith("/strange"):
            self.wfile.write(b"no answer by HTTP\r\n\r\n")
            self.close_connection = True
            return
        text = f"{self.name} {self.path} {self.headers.get('Cookie')}".encode()
        self.send_response(200)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        self.wfile.write(b"%x\r\n%s\r\n0\r\n\r\n" % (len(text), text))

    def say_a_part(self):
        self.send_response(200)
        self.send_header("Content-Length", "8")
        self.end_headers()
        self.wfile.write(b"part")
        if self.path.endswith("/silent"):
            self.rfile.read(1)
            self.left.set()
        else:
            Event().wait(5 * gate._WATCH_S)
            self.wfile.write(b"rest")

    def do_POST(self):
        self.rfile.read(int(self.headers["Content-Length"]))
        self.do_GET()

    def log_message(self, *_):
        pass


@contextmanager
def server(name):
    handler = type(name, (Server,), {"name": name})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as serving:
        Thread(target=serving.serve_forever, args=(0.01,), daemon=True).start()
        yield serving.server_address[1]
        serving.shutdown()


class Stay(HTTPRedirectHandler):
    def redirect_request(self, *_):
        return None


class Browser:
    """Asks without following, and keeps its cookie."""

    def __init__(self, address):
        self._address, self.cookie = address.rstrip("/"), ""

    @property
    def place(self):
        parts = urlsplit(self._address)
        return parts.hostname, parts.port

    def ask(self, path, body=None, **headers):
        cookie = {"Cookie": self.cookie} if self.cookie else {}
        request = Request(self._address + path, data=body, headers=headers | cookie)  # noqa: S310 - loopback
        try:
            return self._take(build_opener(Stay).open(request, timeout=60.0))
        except HTTPError as refused:
            return self._take(refused)

    def _take(self, answer):
        with answer:
            self.cookie = (answer.headers.get("Set-Cookie") or self.cookie).partition(";")[0]
            return answer.status, answer.read().decode(), dict(answer.headers)

    def log_in(self, token):
        return self.ask("/login", urlencode({"token": token}).encode())


@pytest.fixture
def token_file(tmp_path):
    return tmp_path / "view.token"


@pytest.fixture
def browser(token_file):
    config = ViewConfig(bind="0.0.0.0", token_file=token_file)  # noqa: S104 - behind the token
    with (
        server("page") as page,
        server("data") as data,
        open_gate(config, token_file, page_port=page, data_port=data) as address,
    ):
        yield Browser(address.replace("0.0.0.0", "127.0.0.1"))  # noqa: S104


READ = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"


@pytest.mark.parametrize("path", ["/", "/re_viewer.js", READ, "/login", "//", "/%2e%2e/"])
def test_without_the_token_nothing_is_shown_but_the_question_for_it(browser, path):
    for cookie in ("", "rpod_view=", "rpod_view=guessed"):
        browser.cookie = cookie
        status, text, _ = browser.ask(path)
        assert status == 401
        assert 'name="token"' in text
        assert browser.ask(path, b"x")[0] == 401


def test_a_wrong_token_is_refused_and_told(browser, token_file, caplog):
    token = token_file.read_text().strip()
    for wrong in ("", "wrong", token[:-1], token + "x"):
        assert browser.log_in(wrong)[0] == 401
        assert not browser.cookie
    assert caplog.text.count("gave a wrong token") == 4
    assert token not in caplog.text


def test_with_the_token_page_and_data_come_from_one_address(browser, token_file, caplog):
    caplog.set_level("INFO")
    token = token_file.read_text().strip()
    status, _, headers = browser.log_in(token)
    assert status == 303
    assert re.search(r"HttpOnly.*SameSite=Strict", headers["Set-Cookie"])
    assert re.fullmatch(r"/\?url=rerun%2Bhttp%3A%2F%2F127\.0\.0\.1%3A\d+%2Fproxy", headers["Location"])
    assert browser.ask("/")[2]["Location"] == headers["Location"]
    assert browser.ask(headers["Location"])[1].startswith("page /?url=rerun")
    assert browser.ask("/re_viewer.js")[:2] == (200, "page /re_viewer.js None"), "the cookie stays here"
    assert browser.ask(READ, b"\0\0\0\0\0")[:2] == (200, f"data {READ} None")
    assert token not in headers["Set-Cookie"] + headers["Location"] + caplog.text


def test_a_viewer_writes_nothing(browser, token_file):
    browser.log_in(token_file.read_text().strip())
    assert browser.ask(READ.replace("Read", "Write"), b"\0\0\0\0\0")[0] == 403


def test_a_request_that_is_too_large_is_refused_by_name(browser, token_file):
    assert browser.ask("/login", urlencode({"token": "x" * (1 << 17)}).encode())[0] == 413
    browser.log_in(token_file.read_text().strip())
    assert browser.ask(READ, b"x" * (1 << 17))[0] == 413


def test_a_server_that_does_not_speak_http_is_told(browser, token_file):
    browser.log_in(token_file.read_text().strip())
    status, text, _ = browser.ask("/strange")
    assert (status, text) == (502, "the viewer does not answer; try again\n")


def test_a_link_ends_when_the_browser_goes_though_nothing_is_sent(monkeypatch, browser, token_file):
    monkeypatch.setattr(gate, "_WATCH_S", 0.02)
    browser.log_in(token_file.read_text().strip())
    Server.left.clear()
    with socket.create_connection(browser.place, timeout=60.0) as link:
        link.sendall(f"GET /silent HTTP/1.1\r\nHost: x\r\nCookie: {browser.cookie}\r\n\r\n".encode())
        with link.makefile("rb") as answer:
            assert next(line for line in answer if line == b"\r\n")
            assert answer.read(7) == b"4\r\npart"
    assert Server.left.wait(10.0)


def test_a_pause_of_the_data_ends_nothing(monkeypatch, browser, token_file):
    monkeypatch.setattr(gate, "_WATCH_S", 0.02)
    browser.log_in(token_file.read_text().strip())
    assert browser.ask("/pausing")[1] == "partrest"


def test_an_error_behind_the_gate_is_not_taken_for_an_address_in_use(monkeypatch, token_file):
    @contextmanager
    def opened(*_, **__):
        yield "http://192.0.2.7:9090/"

    monkeypatch.setattr(gate, "open_gate", opened)
    config = ViewConfig(bind="192.0.2.7", token_file=token_file)
    with pytest.raises(OSError, match="disk"), viewer._gate(config, token_file, config):
        raise OSError(28, "the disk is full")


def test_the_token_is_made_once_and_read_by_its_owner_alone(token_file):
    token = read_token(token_file)
    assert len(token) >= 32
    assert stat.S_IMODE(token_file.stat().st_mode) == 0o600
    assert read_token(token_file) == token
    token_file.chmod(0o640)
    with pytest.raises(GateError, match=r"mode 640.*chmod 600"):
        read_token(token_file)
    token_file.chmod(0o600)
    token_file.write_text("short")
    with pytest.raises(GateError, match="5 characters"):
        read_token(token_file)


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({"bind": "0.0.0.0"}, "give token_file"),  # noqa: S104
        ({"bind": "192.0.2.7"}, "SSH tunnel"),
        ({"bind": "192.0.2.7", "token_file": "t", "viewer": "native"}, "a window needs no address"),
    ],
)
def test_the_network_is_refused_without_a_token(document, says):
    with pytest.raises(ConfigurationError, match=says):
        check(ViewConfig, document, source="test")
