"""The number of a start, by which one start of a client is distinguished from the next.

Receivers know a publisher by its session's identity and by the publisher's number within it. A client that
takes an identity a second time is not heard until it has published as many messages as it had before: Zenoh's
advanced subscriber takes them for old ones.
"""

import fcntl
import logging
import time

from rpod_schemas.caches.folder import cache_folder

log = logging.getLogger(__name__)


def next_start(name: str) -> int:
    """Return a number that is one higher than that of the start before on this host.

    The number is kept in the folder ``starts`` of the cache. The first one follows from the time, so that a
    host without its cache does not begin with the numbers of its last starts. If the folder cannot be
    written, each one follows from the time, and the log says so.

    Args:
        name: configured identity of the client, hexadecimal.
    """
    file = cache_folder() / "starts" / name
    by_time = time.time_ns() // 250_000_000  # rises between two starts of one service
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("a+", encoding="ascii", errors="replace") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX)  # until the file is closed
            stream.seek(0)
            last = stream.read(20)
            number = int(last) + 1 if last.isdecimal() else by_time
            stream.truncate(0)
            stream.write(str(number))
    except OSError as error:
        log.warning(
            "the number of this start cannot be kept (%s): receivers may take its first messages for those "
            "of an earlier start; make the folder writable, or set RPOD_CACHE to another one",
            error,
        )
        return by_time
    return number
