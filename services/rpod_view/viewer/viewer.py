"""Output of the view: a window, a web page or a file. The viewer is Rerun's program in its own process."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from ipaddress import IPv4Address
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event

import rerun as rr

from rpod_schemas.config.facility.view import ViewConfig
from rpod_view.errors import ViewerFailedError

APPLICATION = "rpod"
_START_TIMEOUT_S = 30.0
_POLL_S = 0.05
_END_TIMEOUT_S = 3.0
_LAST_FLUSH_S = 2.0


@dataclass
class Viewer:
    """A recording and the process that shows it; created by ``open_viewer``."""

    recording: rr.RecordingStream
    where: str
    """Place of the output, for the operator: "a window", the address of the page, or the file."""
    process: subprocess.Popen[bytes] | None = None
    """Process of the viewer; None if the output is a file."""

    @property
    def how(self) -> str:
        """How the drawing reaches the viewer, in words for the operator."""
        return "written to" if self.process is None else "shown in"

    @property
    def closed(self) -> bool:
        """Whether the viewer was closed."""
        return self.process is not None and self.process.poll() is not None

    def has_taken(self, timeout_s: float) -> bool:
        """Wait up to the timeout; return whether the viewer has received everything that was drawn.

        Data that it has not received wait in memory, so nothing more must be drawn until it has.
        """
        try:
            self.recording.flush(timeout_sec=timeout_s)
        except RuntimeError:  # the viewer is slow, or has ended
            return False
        return True


@contextmanager
def open_viewer(config: ViewConfig, stop: Event) -> Iterator[Viewer]:
    """Open a viewer, or the file that is written instead.

    Raises:
        ViewerFailedError: the viewer does not start.
    """
    recording = rr.RecordingStream(APPLICATION)
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    with ExitStack() as stack:
        stack.callback(recording.disconnect)  # last, because it waits for a viewer that does not respond
        if config.save is not None:
            _save(recording, config.save)
            yield Viewer(recording, str(config.save))
            return
        asked = config
        if asked.is_open:  # Rerun's servers have no login: they listen here alone, behind the gate
            config = config.model_copy(update={"bind": IPv4Address("127.0.0.1"), "port": 0, "web_port": 0})
        config = _with_ports(config)
        is_web = asked.is_open or config.viewer == "web" or (config.viewer is None and not has_display())
        process = stack.enter_context(_process(config, web=is_web))
        _await_listening(process, config, stop)
        recording.connect_grpc(config.data_url)
        where = config.page_url if is_web else "a window"
        if asked.is_open and asked.token_file is not None:
            where = stack.enter_context(_gate(asked, asked.token_file, config))
        viewer = Viewer(recording, where, process)
        stack.callback(viewer.has_taken, _LAST_FLUSH_S)
        yield viewer


@contextmanager
def _gate(asked: ViewConfig, token_file: Path, here: ViewConfig) -> Iterator[str]:
    """Open the gate to a viewer that listens here alone; yields what the operator is told."""
    from rpod_view.viewer.gate import open_gate  # noqa: PLC0415 - few views are open to others

    with ExitStack() as stack:
        try:
            gate = open_gate(asked, token_file, page_port=here.web_port, data_port=here.port)
            address = stack.enter_context(gate)
        except OSError as error:
            raise _cannot_listen(str(asked.bind), asked.web_port, error) from error
        yield f"{address}, with the token in {token_file}"


def _cannot_listen(host: str, port: int, error: OSError) -> ViewerFailedError:
    return ViewerFailedError(f"cannot listen on {host}:{port} ({error.strerror})")


def _save(recording: rr.RecordingStream, path: Path) -> None:
    try:
        recording.save(path)
    except RuntimeError as error:
        raise ViewerFailedError(f"cannot write {path} ({error})") from error


def has_display() -> bool:
    """Return whether windows can be opened here."""
    return not sys.platform.startswith("linux") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def _with_ports(config: ViewConfig) -> ViewConfig:
    """Return the configuration with free ports in place of 0; raise an error if a port is in use."""
    family = socket.AF_INET if config.bind.version == 4 else socket.AF_INET6
    ports = {}
    with ExitStack() as stack:
        for name in ("port", "web_port"):
            probe = stack.enter_context(socket.socket(family))
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            address = str(config.bind), getattr(config, name)
            try:
                probe.bind(address)
            except OSError as error:
                raise _cannot_listen(*address, error) from error
            ports[name] = probe.getsockname()[1]
    return config.model_copy(update=ports)


@contextmanager
def _process(config: ViewConfig, *, web: bool) -> Iterator[subprocess.Popen[bytes]]:
    """Run the viewer; at the end stop its process group, because the command does not stop its child."""
    page = ("--serve-web", "--web-viewer-port", str(config.web_port)) if web else ("--hide-welcome-screen",)
    memory = f"{config.memory_bytes // 1_000_000}MB"
    limits = ("--memory-limit", memory, "--server-memory-limit", memory)
    where = ("--bind", str(config.bind), "--port", str(config.port))
    with (
        _private_environment() as environment,
        subprocess.Popen(
            [sys.executable, "-m", "rpod_view.viewer.process", *where, *page, *limits],
            stdin=subprocess.PIPE,  # closed at the end
            stdout=sys.stderr.fileno(),
            start_new_session=True,
            env=environment,
        ) as process,
    ):
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                process.wait(_END_TIMEOUT_S)
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


@contextmanager
def _private_environment() -> Iterator[dict[str, str]]:
    """Yield an environment in which Rerun sends no usage reports, whatever the user's own settings."""
    with TemporaryDirectory(prefix="rpod-view-") as settings:
        environment = os.environ | {"RUST_LOG": "warn", "XDG_CONFIG_HOME": settings}
        subprocess.run(
            [sys.executable, "-m", "rerun_cli", "analytics", "disable"],
            env=environment,
            capture_output=True,
            check=False,
        )
        yield environment


def _await_listening(process: subprocess.Popen[bytes], config: ViewConfig, stop: Event) -> None:
    deadline_s = time.monotonic() + _START_TIMEOUT_S
    address = str(config.bind) if not config.bind.is_unspecified else "localhost"
    while not stop.is_set():
        if process.poll() is not None:
            raise ViewerFailedError(f"ended with exit code {process.returncode}")
        with suppress(OSError), socket.create_connection((address, config.port), timeout=1.0):
            return
        if time.monotonic() > deadline_s:
            raise ViewerFailedError(f"does not answer within {_START_TIMEOUT_S:.0f} s")
        stop.wait(_POLL_S)
