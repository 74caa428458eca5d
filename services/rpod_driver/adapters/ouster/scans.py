"""Sends the scans of an Ouster by frame_pipe; it runs in an environment of its own, with ouster-sdk (1.0).

Points are in axes x right, y down, z along the boresight, which is the x axis of Ouster's sensor frame. Rows
are destaggered. A scan's stamp is the middle of its first and last column. Columns that were not received are
NaN, and are reported. A recording is played at its pace (``--play``).
"""

import argparse
import sys
import time
from typing import Any

import numpy as np

_PTP = "TIME_FROM_PTP_1588"
_TURN_S = 0.5
"""Longest time for which a player sends nothing, s."""


def main(arguments: "list[str]") -> int:
    """Send scans until the source ends; return the exit code."""
    import frame_pipe  # noqa: PLC0415 # pyright: ignore[reportMissingImports] - beside it when it runs

    parser = argparse.ArgumentParser()
    parser.add_argument("--ptp-offset", type=float, default=37.0)
    parser.add_argument("--sensor-index", type=int, default=-1)
    parser.add_argument("--play", action="store_true")
    parser.add_argument("source")
    parser.add_argument("metadata", nargs="?")
    options = parser.parse_args(arguments)
    sender = frame_pipe.open_sender()
    try:
        _send(sender, options)
    except Exception as error:  # noqa: BLE001 - the SDK raises RuntimeError and others; the host tells it
        sender.send("error", text=f"{options.source}: {error or type(error).__name__}")
        return 1
    sender.send("end")
    return 0


def _send(sender: Any, options: argparse.Namespace) -> None:
    from ouster import sdk  # noqa: PLC0415 # pyright: ignore[reportMissingImports] - only here

    given = {"meta": [options.metadata]} if options.metadata else {}
    source = sdk.open_source(options.source, sensor_idx=options.sensor_index, **given)
    try:
        info = _only(source.sensor_info)
        form = info.format
        mode = str(info.config.timestamp_mode or "unknown")
        sender.send(
            "info",
            text=f"{info.prod_line} {info.fw_rev}, {form.pixels_per_column} x {form.columns_per_frame}, "
            f"timestamp_mode {mode}, ouster-sdk {sdk.__version__}",
        )
        ahead_ns = round(options.ptp_offset * 1e9) if _PTP in mode else 0
        projection, pace = Projection(sdk.core, info, ahead_ns), Pace()
        for scan in (scan for scans in source for scan in scans if scan is not None):
            frame = projection.frame(scan)
            if options.play:
                pace.wait(
                    sender, frame["stamp_ns"] + round(float(np.nanmax(frame["arrays"]["time_s"])) * 1e9)
                )
            sender.send("frame", **frame)
    finally:
        source.close()


def _only(infos: "list[Any]") -> Any:
    """Return the description of the one sensor of a source."""
    if len(infos) != 1:
        known = "; ".join(f"{index}: {each.prod_line} {each.sn}" for index, each in enumerate(infos))
        raise RuntimeError(
            f"it holds the scans of {len(infos)} sensors ({known}); set device.sensor_index, and run a "
            "driver for each"
        )
    return infos[0]


class Pace:
    """Holds the scans of a recording back until the times at which they would have arrived."""

    def __init__(self) -> None:
        self._begun_s, self._first_ns, self._last_ns = 0.0, 0, 0

    def wait(self, sender: Any, end_ns: int) -> None:
        """Wait until a scan is due whose last column was measured at a time, ns; announce the pause.

        The first scan is due at once, and so is one whose stamp went back: its sensor had started again.
        """
        if end_ns < self._last_ns or not self._last_ns:
            self._begun_s, self._first_ns = time.monotonic(), end_ns
        self._last_ns = end_ns
        due_s = self._begun_s + (end_ns - self._first_ns) * 1e-9
        while (left_s := due_s - time.monotonic()) > 0.0:
            sender.send("idle", pause_s=left_s)
            time.sleep(min(left_s, _TURN_S))


class Projection:
    """Turns scans of one sensor into points."""

    def __init__(self, core: Any, info: Any, ahead_ns: int) -> None:
        self._core, self._info, self._ahead_ns = core, info, ahead_ns
        self._lut = core.XYZLut(info, use_extrinsics=False)

    def frame(self, scan: Any) -> "dict[str, Any]":
        """Return the arrays and fields of a scan's message."""
        came = (np.asarray(scan.status) & 1) == 1
        stamps = np.asarray(scan.timestamp, np.int64)
        if not came.any():
            raise RuntimeError("a scan without any column came; check the network's packets")
        first, last = int(stamps[came].min()), int(stamps[came].max())
        middle_ns = (first + last) // 2
        counts = np.asarray(scan.field(self._core.ChanField.RANGE))
        x, y, z = np.moveaxis(np.asarray(self._lut(scan)), -1, 0)
        hit = (counts > 0) & came
        points = np.where(hit[..., None], np.stack([-y, -z, x], axis=-1), np.nan).astype(np.float32)
        time_s = np.broadcast_to(np.where(came, (stamps - middle_ns) * 1e-9, np.nan), counts.shape)
        arrays = {
            "points_m": self._straight(points),
            "time_s": self._straight(time_s.astype(np.float32)),
            **self._intensity(scan),
        }
        missing = int(came.size - came.sum())
        partial = f"scan {scan.frame_id} lacks {missing} of {came.size} columns" if missing else ""
        return {"arrays": arrays, "stamp_ns": middle_ns - self._ahead_ns, "partial": partial}

    def _intensity(self, scan: Any) -> "dict[str, np.ndarray]":
        """Return the signal; the reflectivity where the sensor's UDP profile has no signal; else nothing."""
        for channel in (self._core.ChanField.SIGNAL, self._core.ChanField.REFLECTIVITY):
            if channel in scan.fields:
                return {"intensity": self._straight(np.asarray(scan.field(channel)).astype(np.float32))}
        return {}

    def _straight(self, image: "np.ndarray") -> "np.ndarray":
        return np.asarray(self._core.destagger(self._info, np.ascontiguousarray(image)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
