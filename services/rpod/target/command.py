"""``rpod target new`` and ``rpod target check`` from their arguments to their exit codes."""

import json
import shlex
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from rpod.errors import failed
from rpod.steps import Steps
from rpod_analysis.target_check import TargetCheck, check_target, checked_symmetries, write_page
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_target import Target, TargetError, load_target
from rpod_target.drafting.draft import Draft, DraftOptions, draft
from rpod_target.drafting.units import METRES
from rpod_target.mesh.files import FORMATS, METRIC


def new_command(cad: Path, options: DraftOptions, *, out: Path | None, as_json: bool) -> int:
    """Write a parameter file from a CAD file; return the exit code."""
    out = out or Path(f"{cad.stem}.yaml")
    try:
        asked = _asked(cad, options, as_json=as_json)
        with Steps(quiet=as_json) as steps:
            made = draft(cad, out, asked, symmetries=checked_symmetries, say=steps.say)
    except (TargetError, OSError) as error:
        return failed("target new", error)
    if as_json:
        print(json.dumps(_new_document(made), indent=2))
        return EXIT_OK
    console = Console(markup=False, highlight=False)
    for text in made.told:
        console.print(f"{text}", soft_wrap=True)
    for one in made.target.symmetries:
        kind = "exact" if one.exact else "near: a sensor may mistake the turned pose for the right one"
        about = _about(one.axis, one.order, any_turn=one.continuous)
        console.print(f"symmetry {about}, {kind}", soft_wrap=True)
    console.print(f"size     {_sides(made.target)} m: is this the satellite's?", soft_wrap=True)
    console.print(f"target   {made.file}", soft_wrap=True)
    console.print(f"next     rpod target check {shlex.quote(str(made.file))}", soft_wrap=True)
    return EXIT_OK


def _sides(target: Target) -> str:
    """Return the lengths of a target's sides along its axes, m."""
    return " x ".join(f"{side:.4g}" for side in np.ptp(target.triangles_m.reshape(-1, 3), axis=0))


def _about(axis: tuple[float, float, float], order: int, *, any_turn: bool) -> str:
    """Return an axis of symmetry and its turns in words."""
    along = ", ".join(f"{value:.3f}" for value in axis)
    return f"about ({along}): " + ("any turn" if any_turn else f"every {360 / order:.4g} deg")


def _asked(cad: Path, options: DraftOptions, *, as_json: bool) -> DraftOptions:
    """Return the options, completed by questions if someone is there to answer them."""
    known = options.units is not None or options.longest_side_m is not None
    if known or as_json or cad.suffix.lower() in METRIC or not sys.stdin.isatty():
        return options
    answer = input(f"Unit of {cad.name} ({', '.join(METRES)}), or the longest side in m: ").strip()
    try:
        return replace(options, longest_side_m=float(answer))
    except ValueError:
        return replace(options, units=answer or None)


def _new_document(made: Draft) -> dict[str, object]:
    return {
        "file": str(made.file),
        "name": made.target.name,
        "parts": list(made.target.parts),
        "materials": [material.name for material in made.target.materials],
        "symmetries": [
            {"axis": list(one.axis), "order": one.order, "exact": one.exact, "continuous": one.continuous}
            for one in made.target.symmetries
        ],
        "told": list(made.told),
    }


def check_command(
    file: Path,
    *,
    units: str | None,
    longest_side_m: float | None,
    largest_file_mb: float,
    trials: int | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Check a target and draw it; return the exit code."""
    if not as_json:
        print("building the target, then trying all methods on emulated frames ...", file=sys.stderr)
    try:
        target = _target(file, units=units, longest_side_m=longest_side_m, largest_file_mb=largest_file_mb)
        found = check_target(target, trials=trials)
        files = write_page(target, found, out or Path())
    except (TargetError, OSError) as error:
        return failed("target check", error)
    if as_json:
        written = {"page": str(files.page), "picture": str(files.picture)}
        print(json.dumps(found.document() | written, indent=2))
        return EXIT_OK
    console = Console(markup=False, highlight=False)
    _print(found, console)
    console.print(f"page     {files.page}", soft_wrap=True)
    console.print(f"picture  {files.picture}", soft_wrap=True)
    return EXIT_OK


def _target(file: Path, *, units: str | None, longest_side_m: float | None, largest_file_mb: float) -> Target:
    """Return the target of a parameter file or of a name, or one drafted from a CAD file."""
    if file.suffix.lower() not in FORMATS:
        return load_target(file)
    with tempfile.TemporaryDirectory() as folder:
        assumed = units is None and longest_side_m is None and file.suffix.lower() not in METRIC
        units = "m" if assumed else units
        options = DraftOptions(
            units=units,
            longest_side_m=longest_side_m,
            confirmed_size=not assumed,
            largest_file_mb=largest_file_mb,
        )
        made = draft(file, Path(folder) / f"{file.stem}.yaml", options, symmetries=checked_symmetries)
        told = ("coordinates are taken as metres: no unit is given", *made.told) if assumed else made.told
        return replace(made.target, source=str(file), repairs=told)


def _print(found: TargetCheck, console: Console) -> None:
    sides = " x ".join(f"{side:.4g}" for side in found.size.sides_m)
    parts, materials, field = len(found.parts), len(found.materials), found.distance_field
    console.print(
        f"{found.name}: {sides} m, {found.triangles} triangles, {parts} part{'s' * (parts != 1)}, "
        f"{materials} material{'s' * (materials != 1)}; distance field {field.megabytes:.0f} MB, "
        f"{field.spacing_m:.3g} m spacing",
        soft_wrap=True,
    )
    for text in _shape(found):
        console.print(text, soft_wrap=True)
    ignored = [part.name for part in found.parts if part.unreliable]
    if ignored:
        console.print(f"ignored   {', '.join(ignored)}: unreliable parts", soft_wrap=True)
    for frame in found.frames:
        place = ", ".join(f"{value:.4g}" for value in frame.place_m)
        angles = ", ".join(f"{value:.4g}" for value in frame.euler_321_deg)
        console.print(
            f"frame     {frame.name} at ({place}) m, yaw, pitch, roll ({angles}) deg, "
            f"{frame.from_surface_m:.3g} m from the surface",
            soft_wrap=True,
        )
    if found.openings:
        console.print(f"openings  {found.openings}; their places are on the page")
    console.print(_accuracy(found))
    console.print(_methods(found))
    for each in found.methods:
        if each.total.unseen:
            text = (
                f"{each.total.unseen} of {each.total.frames} frames show too little of the target to be tried"
            )
            console.print(f"{each.sensor}.{each.name}: {text}", soft_wrap=True)
        if each.total.wrong:
            text = (
                f"{each.total.wrong_coarse} of {each.total.wrong} wrong poses are coarse: no farther off "
                "than their own standard deviations say"
            )
            console.print(f"{each.sensor}.{each.name}: {text}", soft_wrap=True)
        if each.reason:
            console.print(f"{each.sensor}.{each.name}: {each.reason}", soft_wrap=True)


def _shape(found: TargetCheck) -> Iterator[str]:
    """Yield the lines about repairs and symmetries."""
    yield from (f"repaired  {text}" for text in found.repairs)
    yield from (f"doubtful  {text}" for text in found.doubts)
    for one in found.found_symmetries:
        kind = "exact" if one.exact else "near" if one.mistaken else "near, but sensors can distinguish it"
        yield f"symmetry  {_about(one.axis, one.order, any_turn=one.continuous)}, {kind}"


def _methods(found: TargetCheck) -> Table:
    table = Table(
        title="methods tried on emulated frames (* default)",
        title_justify="left",
        box=None,
        padding=(0, 1, 0, 0),
        caption="ambig.: several poses, the right one among them; refused: no pose is accepted; wrong: a "
        "wrong pose is accepted; deg, mm: median error of the accepted poses; s: median time of a frame",
        caption_justify="left",
    )
    table.add_column("method", no_wrap=True)
    for name in ("right", "ambig.", "refused", "wrong", "deg", "mm", "s"):
        table.add_column(name, justify="right", no_wrap=True)
    for each in found.methods:
        all_ = each.total
        table.add_row(
            f"{each.sensor}.{each.name}{'*' * each.default}",
            f"{all_.right} of {all_.frames - all_.unseen}" if all_.frames else "not tried",
            *(str(count) if all_.frames else "-" for count in (all_.ambiguous, all_.refused, all_.wrong)),
            _short(all_.attitude_deg),
            _short(all_.position_m, 1e3),
            _short(each.median_ms, 1e-3),
        )
    return table


def _short(value: float | None, factor: float = 1.0) -> str:
    """Return a number in two digits, or in whole units from 100 on; "-" for None."""
    if value is None:
        return "-"
    return f"{factor * value:.0f}" if abs(factor * value) >= 99.5 else f"{factor * value:.2g}"


def _accuracy(found: TargetCheck) -> Table:
    table = Table(
        title="accuracy of one frame (1 sigma, worst axis), as the default tracker states it",
        title_justify="left",
        caption="points: returns or pixels on the target; position, attitude: medians over random attitudes, "
        "-: most frames give no pose; edges: edges of the model that the sensor resolves",
        caption_justify="left",
    )
    for name in ("sensor", "range, m", "points", "position, mm", "attitude, deg", "edges"):
        table.add_column(name, justify="left" if name == "sensor" else "right")
    for sensor in found.accuracy:
        for at in sensor.ranges:
            table.add_row(
                sensor.sensor,
                f"{at.range_m:.3g}",
                str(at.points),
                _short(at.sigma_position_m, 1e3),
                _short(at.sigma_attitude_deg),
                str(found.edges_seen[sensor.sensor][f"{at.range_m:.4g}"]),
            )
    return table
