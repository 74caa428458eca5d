"""``rpod calibrate background`` from its arguments to its exit code."""

import json
import sys
from pathlib import Path

import yaml

from rpod.calibrate.unreadable import print_unreadable
from rpod.errors import failed
from rpod_analysis import AnalysisError, open_log
from rpod_analysis.calibration.background import learned_backgrounds
from rpod_pose.surroundings.known import KnownSurroundingsError
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.topics import TRUTH


def background_command(path: Path, *, out: Path | None, as_json: bool) -> int:
    """Learn what each sensor of a log sees without the target; return the exit code."""
    out = out or Path("surroundings.yaml")
    sensors, found = {}, {}
    try:
        with open_log(path) as log:
            learned = learned_backgrounds(log)
            for name, background in learned.backgrounds.items():
                file = out.with_name(f"{out.stem}-{name}.npz")
                background.write(file)
                sensors[name] = {"background": file.name}
                known_share = float((background.range_m > 0.0).mean())
                found[name] = {"frames": background.frames, "known_share": known_share}
            print_unreadable("rpod calibrate background", log)
            for name, reason in learned.left_out.items():
                print(f"rpod calibrate background: {name!r} has no background: {reason}", file=sys.stderr)
            if next(iter(log.odometry(TRUTH)), None) is not None:
                print(
                    f"rpod calibrate background: {path.name}: the log has truth; a target in view "
                    "that stands still becomes part of the background: log without the target",
                    file=sys.stderr,
                )
        out.write_text(yaml.safe_dump({"sensors": sensors}), "utf-8")
    except (AnalysisError, KnownSurroundingsError, OSError) as error:
        return failed("calibrate background", error)
    if as_json:
        print(json.dumps({"file": str(out), "sensors": found, "left_out": learned.left_out}, indent=2))
        return EXIT_OK
    for name, told in found.items():
        print(f"{name}: {told['frames']} frames, {told['known_share']:.0%} of the pixels have a background")
    print(f"surroundings   {out}")
    return EXIT_OK
