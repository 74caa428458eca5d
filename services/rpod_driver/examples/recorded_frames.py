"""Plays recorded frames onto the bus: python recorded_frames.py FRAMES.npz CONFIG.yaml."""

import sys
import time
from collections.abc import Iterator

import numpy as np

from rpod_driver import main
from rpod_driver.pauses import Pauses
from rpod_schemas.types import Camera, PmdFrame


class RecordedFrames:
    """A camera whose frames are in a NumPy file: stamp_ns, depth_m, amplitude, camera (fx, fy, cx, cy)."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._pauses = Pauses()

    def connect(self) -> None:
        """Open the file."""
        self._file = np.load(self._path)

    def frames(self) -> Iterator[PmdFrame | None]:
        """Yield the frames at their pace, stamped as if taken now: an estimator refuses old ones."""
        stamps_ns, depths_m, amplitudes = (self._file[name] for name in ("stamp_ns", "depth_m", "amplitude"))
        fx, fy, cx, cy = self._file["camera"]
        camera = Camera(height=depths_m.shape[1], width=depths_m.shape[2], fx=fx, fy=fy, cx=cx, cy=cy)
        stamps_ns = stamps_ns - stamps_ns[0] + time.time_ns()
        for stamp_ns, depth_m, amplitude in zip(stamps_ns.tolist(), depths_m, amplitudes, strict=True):
            yield from self._pauses.until(time.monotonic() + (stamp_ns - time.time_ns()) * 1e-9)
            optical = {"stamp_ns": stamp_ns, "frame_id": "pmd_optical", "camera": camera}
            yield PmdFrame(depth_m=depth_m, amplitude=amplitude, **optical)

    def due_s(self) -> float:
        """Return when the next frame is due: a gap of the recording is no silence of a device."""
        return self._pauses.due_s

    def close(self) -> None:
        """Close the file."""
        self._file.close()


if __name__ == "__main__":
    sys.exit(main(RecordedFrames(sys.argv[1]), sys.argv[2]))
