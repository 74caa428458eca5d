"""Sends the scans of an Ouster by frame_pipe; it runs in an environment of its own, with ouster-sdk (1.0).

Points are in axes x right, y down, z along the boresight, which is the x axis of Ouster's sensor frame. Rows
are destaggered. A scan's stamp is the middle of its first and last column. Columns that were not received are
NaN, and are reported.
"""

import argparse
import sys
from typing import Any

import numpy as np

_PTP = "TIME_FROM_PTP_1588"


def main(arguments: "list[str]") -> int:
    """Send scans until the source ends; return the exit code."""
    import frame_pipe  # noqa: PLC0415 # pyright: ignore[reportMissingImports] - beside it when it runs

    parser = argparse.ArgumentParser()
    parser.add_argument("--ptp-offset", type=float, default=37.0)
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
    source = sdk.open_source(options.source, **given)
    try:
        (info, *_) = source.sensor_info
        form = info.format
        mode = str(info.config.timestamp_mode or "unknown")
        sender.send(
            "info",
            text=f"{info.prod_line} {info.fw_rev}, {form.pixels_per_column} x {form.columns_per_frame}, "
            f"timestamp_mode {mode}, ouster-sdk {sdk.__version__}",
        )
        ahead_ns = round(options.ptp_offset * 1e9) if _PTP in mode else 0
        projection = Projection(sdk.core, info, ahead_ns)
        for scans in source:
            for scan in scans:
                if scan is not None:
                    sender.send("frame", **projection.frame(scan))
    finally:
        source.close()


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
        signal = np.asarray(scan.field(self._core.ChanField.SIGNAL))
        arrays = {
            "points_m": self._straight(points),
            "intensity": self._straight(signal.astype(np.float32)),
            "time_s": self._straight(time_s.astype(np.float32)),
        }
        missing = int(came.size - came.sum())
        partial = f"scan {scan.frame_id} lacks {missing} of {came.size} columns" if missing else ""
        return {"arrays": arrays, "stamp_ns": middle_ns - self._ahead_ns, "partial": partial}

    def _straight(self, image: "np.ndarray") -> "np.ndarray":
        return np.asarray(self._core.destagger(self._info, np.ascontiguousarray(image)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
