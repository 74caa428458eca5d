"""``rpod target errors`` from its arguments to its exit code."""

import json
import re
import sys
from pathlib import Path

from rich.console import Console

from rpod.errors import failed
from rpod_analysis.target_check.camera_errors import CameraErrors, measure_camera_errors
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_target import Target, TargetError, load_target

_BLOCK = re.compile(r"^camera_errors:.*\n?(?:[ \t].*\n?)*", re.MULTILINE)
"""The field of a parameter file with the lines that belong to it."""


def errors_command(file: Path, *, frames: int, seed: int, write: bool, as_json: bool) -> int:
    """Measure the errors of a target's edges in a camera's images; return the exit code."""
    try:
        target = load_target(file)
        if write and not file.is_file():
            reason = "is a name, not a parameter file: leave out --write, or copy the file first"
            raise TargetError(str(file), "--write", reason)
        if not as_json:
            print(f"tracking {frames} emulated frames ...", file=sys.stderr)
        found = measure_camera_errors(target, frames=frames, seed=seed)
        if write:
            file.write_text(with_block(file.read_text("utf-8"), found.block()), "utf-8")
    except (TargetError, OSError) as error:
        return failed("target errors", error)
    if as_json:
        print(json.dumps(found.document() | {"written": str(file) if write else None}, indent=2))
        return EXIT_OK
    _print(target, found, Console(markup=False, highlight=False))
    if write:
        print(f"written  {file}")
    else:
        print(f"to use it, give --write, or add to {target.source}:\n{found.block()}", end="")
    return EXIT_OK


def with_block(text: str, block: str) -> str:
    """Return the text of a parameter file with a block in place of its ``camera_errors``, or at its end."""
    if _BLOCK.search(text):
        return _BLOCK.sub(lambda _: block, text, count=1)
    return text + ("" if text.endswith("\n") or not text else "\n") + block


def _print(target: Target, found: CameraErrors, console: Console) -> None:
    low, high = found.interval
    console.print(
        f"{target.name}: errors of edges in a camera's images have {found.factor:.2f} times the variance "
        f"[{low:.2f}, {high:.2f}] that a frame states ({found.frames} accepted poses of {found.tried} "
        f"frames, seed {found.seed})",
        soft_wrap=True,
    )
    console.print(f"mean NEES {found.nees:.1f}, with the factor {found.nees_with:.1f}", soft_wrap=True)
    if found.factor == 1.0:
        console.print("the frames state their errors right, or too large: nothing changes", soft_wrap=True)
