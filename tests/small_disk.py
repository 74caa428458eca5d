"""Disks for tests that fill up, turn read-only and vanish: a tmpfs, where the machine lets us mount one."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


class SmallDisk:
    """A mounted tmpfs."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def fill(self, leave_bytes: int = 0) -> Path:
        """Fill it with one file up to so many bytes; return the file."""
        ballast = self.path / "ballast"
        with ballast.open("wb", buffering=0) as stream:
            try:
                while stream.write(bytes(1 << 16)):
                    pass
            except OSError:
                stream.truncate(max(0, stream.tell() - leave_bytes))
        return ballast

    def remount(self, *options: str) -> None:
        _run("mount", "-o", ",".join(("remount", *options)), str(self.path))

    def vanish(self) -> None:
        """Take the mount away from under those who use it."""
        _run("umount", "--lazy", str(self.path))


@contextmanager
def small_disk(path: Path, size_bytes: int) -> Iterator[SmallDisk]:
    """Mount a disk for as long as a test lasts; skip the test where that is not allowed."""
    path.mkdir()
    try:
        _run("mount", "-t", "tmpfs", "-o", f"size={size_bytes}", "tmpfs", str(path))
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no permission to mount a tmpfs")
    try:
        yield SmallDisk(path)
    finally:
        if path.is_mount():
            _run("umount", "--lazy", str(path))


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True)
