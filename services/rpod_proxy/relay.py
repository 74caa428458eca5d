"""Passes the bytes of a link's connections on, in the condition that the link is in.

The proxy holds as little as it can: the kernel's buffers are small, and its own holds what is on its way. So
a slow link fills the sender's queue, as a real one does, not the proxy's.
"""

import asyncio
import random
import socket
import struct
import time
from contextlib import suppress

from rpod_proxy.condition import CHUNK_BYTES, GOOD, Condition

_BUFFER_BYTES = 65_536
"""Size of the kernel's buffers and, beside what is on its way, of the proxy's own."""
_FASTEST_B_S = 100e6
"""Rate of a link without a limit by which the bytes on their way are counted."""
_POLL_S = 0.005

Address = tuple[str, int]


class Relay:
    """One link: all connections from its service to the router. It lives in an event loop."""

    def __init__(self, listen: Address, target: Address, *, seed: int = 0) -> None:
        self._listen, self._target = listen, target
        self._random = random.Random(seed)
        self._condition = GOOD
        self._writers: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None
        self.passed_bytes = 0
        """Number of bytes passed on, in both directions."""

    @property
    def connections(self) -> int:
        """Number of open connections."""
        return len(self._writers) // 2

    async def open(self) -> None:
        """Listen. Raises ``OSError``."""
        listener = socket.create_server(self._listen, backlog=128)
        _keep_small(listener)
        self._server = await asyncio.start_server(self._accept, sock=listener)

    def close(self) -> None:
        """Stop listening and close all connections."""
        if self._server:
            self._server.close()
        self._abort()

    def set(self, condition: Condition) -> None:
        """Set the condition; connections over a link that was dead are reset: bytes of them are lost."""
        if (self._condition.dead and not condition.dead) or condition.cut:
            self._abort()
        self._condition = condition

    def _abort(self) -> None:
        for writer in list(self._writers):
            _reset(writer)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._condition.cut:
            _reset(writer)
            return
        _keep_small(writer.get_extra_info("socket"))
        try:
            reader_2, writer_2 = await self._connected()
        except OSError:
            writer.transport.abort()
            return
        both = (writer, writer_2)
        if self._condition.cut:  # since the connection came
            for each in both:
                _reset(each)
            return
        self._writers.update(both)
        try:
            await asyncio.gather(self._pump(reader, writer_2), self._pump(reader_2, writer))
        finally:
            for each in both:
                self._writers.discard(each)
                each.transport.abort()

    async def _connected(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Return a connection to the router. Raises ``OSError``; no socket stays open then."""
        onward = socket.socket()
        try:
            _keep_small(onward)
            onward.setblocking(False)
            await asyncio.get_running_loop().sock_connect(onward, self._target)
            return await asyncio.open_connection(sock=onward, limit=_BUFFER_BYTES)
        except BaseException:
            onward.close()
            raise

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass one direction on until either side closes."""
        waiting = _Waiting()
        sending = asyncio.create_task(self._send(waiting, writer))
        with suppress(OSError):
            while not waiting.given_up and (data := await reader.read(CHUNK_BYTES)):
                await waiting.put(data, room=self._room())
        await waiting.put(b"", room=None)
        await sending
        writer.transport.close()

    def _room(self) -> int:
        rate_B_s = min(self._condition.rate_B_s or _FASTEST_B_S, _FASTEST_B_S)
        return _BUFFER_BYTES + round(rate_B_s * self._condition.delay_s)

    async def _send(self, waiting: "_Waiting", writer: asyncio.StreamWriter) -> None:
        try:
            await self._send_all(waiting, writer)
        except OSError:  # the other side has closed
            waiting.give_up()
            _reset(writer)

    async def _send_all(self, waiting: "_Waiting", writer: asyncio.StreamWriter) -> None:
        free_s = 0.0
        while True:
            arrived_s, data = await waiting.get()
            await self._wait(arrived_s, is_end=not data)
            if not data:
                return
            if self._condition.dead:
                continue
            lost_s = self._condition.lost_s(len(data), more=bool(waiting), random=self._random)
            if lost_s:
                await asyncio.sleep(lost_s)
            if self._condition.rate_B_s:
                free_s = max(time.monotonic(), free_s) + len(data) / self._condition.rate_B_s
                await asyncio.sleep(free_s - time.monotonic())
            writer.write(data)
            self.passed_bytes += len(data)
            await writer.drain()

    async def _wait(self, arrived_s: float, *, is_end: bool) -> None:
        """Wait for the end of the delay and of a stall. The end of a connection waits on a dead link too."""
        while (left_s := arrived_s + self._condition.delay_s - time.monotonic()) > 0.0:
            await asyncio.sleep(min(left_s, _POLL_S * 4))
        while self._condition.stalled or (is_end and self._condition.dead):
            await asyncio.sleep(_POLL_S)


class _Waiting:
    """Data on their way, with the time of their arrival."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        self._bytes = 0
        self._taken = asyncio.Event()
        self.given_up = False
        """Whether nobody takes the data any more."""

    def give_up(self) -> None:
        """Release all who wait for room, now and later."""
        self.given_up = True
        self._taken.set()

    def __bool__(self) -> bool:
        return not self._queue.empty()

    async def put(self, data: bytes, *, room: int | None) -> None:
        """Add data as soon as there is room for them."""
        while not self.given_up and room is not None and self._bytes and self._bytes + len(data) > room:
            self._taken.clear()
            await self._taken.wait()
        self._bytes += len(data)
        self._queue.put_nowait((time.monotonic(), data))

    async def get(self) -> tuple[float, bytes]:
        """Return the oldest data; empty at the end."""
        item = await self._queue.get()
        self._bytes -= len(item[1])
        self._taken.set()
        return item


def _reset(writer: asyncio.StreamWriter) -> None:
    """Close a connection as a host does that does not know it: by a reset."""
    held = writer.get_extra_info("socket")
    with suppress(OSError):
        held.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


def _keep_small(held: socket.socket) -> None:
    for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        held.setsockopt(socket.SOL_SOCKET, option, _BUFFER_BYTES)
