"""``rpod calibrate camera`` from its arguments to its exit code."""

import json
import re
from pathlib import Path

import yaml

from rpod.calibrate.unreadable import print_unreadable
from rpod.errors import failed
from rpod_analysis import AnalysisError, open_log
from rpod_analysis.calibration.intrinsics import (
    Checkerboard,
    Intrinsics,
    find_intrinsics,
    images_in,
    images_of,
)
from rpod_runtime.process.lifecycle import EXIT_OK, EXIT_USAGE


def camera_command(
    images: Path, *, pattern: str, square_mm: float, sensor: str, model: str, out: Path | None, as_json: bool
) -> int:
    """Find a camera's intrinsics from images of a checkerboard; return the exit code."""
    corners = re.fullmatch(r"(\d+)x(\d+)", pattern)
    if corners is None or min(int(corners[1]), int(corners[2])) < 3:
        reason = f"--pattern is {pattern!r}; give the numbers of inner corners, 3 or more each way, as 9x6"
        return failed("calibrate camera", reason, EXIT_USAGE)
    if model not in ("plumb_bob", "rational_polynomial"):
        reason = f"--model is {model!r}; give plumb_bob or rational_polynomial"
        return failed("calibrate camera", reason, EXIT_USAGE)
    board = Checkerboard(int(corners[1]), int(corners[2]), 1e-3 * square_mm)
    try:
        if images.is_dir() and not list(images.glob("*.mcap")):
            found = find_intrinsics(images_in(images), board, model)
        else:
            with open_log(images) as log:
                found = find_intrinsics(images_of(log, sensor), board, model)
                print_unreadable("rpod calibrate camera", log)
        file = out or Path(f"{sensor}-camera.yaml")
        document = found.camera.model_dump(mode="json")
        lines = list(found.findings())
        comment = "".join(f"# {line}\n" for line in lines)
        file.write_text(comment + yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    except (AnalysisError, OSError) as error:
        return failed("calibrate camera", error)
    if as_json:
        print(json.dumps(_as_json(found) | {"file": str(file), "findings": lines}, indent=2))
    else:
        print("\n".join([*lines, f"camera        {file}"]))
    return EXIT_OK


def _as_json(found: Intrinsics) -> dict[str, object]:
    return {
        "camera": found.camera.model_dump(mode="json"),
        "sigma": dict(zip(("fx", "fy", "cx", "cy"), found.sigma_px.tolist(), strict=True)),
        "rms_px": found.rms_px,
        "images": found.images,
        "found": found.found,
        "used": found.used,
        "covered_share": found.covered_share,
    }
