"""The verbs about targets: new, check and errors."""

import errno
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from rpod.options import JsonOption

target_verbs = typer.Typer(
    name="target",
    no_args_is_help=True,
    rich_markup_mode=None,
)

UnitsOption = Annotated[
    str | None, typer.Option("--units", help="Unit of the CAD file: m, dm, cm, mm, in, ft or km.")
]
LongestOption = Annotated[
    float | None,
    typer.Option("--longest-side-m", help="Length to which the longest side is scaled, m.", min=1e-6),
]

LargestFileOption = Annotated[
    float,
    typer.Option(
        "--largest-file-mb",
        help="Largest size of the CAD file with the files that it refers to, MB.",
        min=1e-3,
    ),
]
_LARGEST_FILE_MB = 500.0


def _needs(file: Path, verb: str) -> None:
    """End at once if a file is not there: what reads it takes seconds to import."""
    if not file.exists():
        print(f"rpod target {verb}: {file}: cannot be read ({os.strerror(errno.ENOENT)})", file=sys.stderr)
        raise typer.Exit(2)


@target_verbs.callback()
def target() -> None:
    """Make a target from a CAD file, and see what rpod makes of it."""


@target_verbs.command()
def new(
    cad: Annotated[Path, typer.Argument(help="STL, OBJ, PLY, OFF, glTF, GLB or STEP file.")],
    units: UnitsOption = None,
    longest_side_m: LongestOption = None,
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the target; that of the file by default.")
    ] = None,
    mass_kg: Annotated[float | None, typer.Option("--mass-kg", help="Mass, kg.", min=1e-9)] = None,
    density_kg_m3: Annotated[
        float | None, typer.Option("--density-kg-m3", help="Density, kg/m3, instead of the mass.", min=1e-9)
    ] = None,
    origin: Annotated[
        str,
        typer.Option(
            "--origin",
            help="Origin of target axes: file, centre (of area), or auto: the file's if it lies within the "
            "bounding box and on the axes of the symmetries.",
        ),
    ] = "auto",
    confirm_size: Annotated[
        bool, typer.Option("--confirm-size", help="Confirm a size below 0.05 m or above 500 m.")
    ] = False,
    largest_file_mb: LargestFileOption = _LARGEST_FILE_MB,
    out: Annotated[
        Path | None, typer.Option("--out", help="Parameter file to write; <cad>.yaml by default.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a target's parameter file from a CAD file.

    It has parts, materials, mass and symmetries.
    """
    if origin not in {"auto", "file", "centre"}:
        raise typer.BadParameter("is not one of auto, file, centre", param_hint="--origin")
    _needs(cad, "new")
    from rpod.target.command import new_command
    from rpod_target.drafting.draft import DraftOptions

    options = DraftOptions(
        units=units,
        longest_side_m=longest_side_m,
        name=name,
        mass_kg=mass_kg,
        density_kg_m3=density_kg_m3,
        origin=origin,  # type: ignore[arg-type]
        confirmed_size=confirm_size,
        largest_file_mb=largest_file_mb,
    )
    raise typer.Exit(new_command(cad, options, out=out, as_json=as_json))


@target_verbs.command()
def check(
    file: Annotated[Path, typer.Argument(help="Parameter file or name of a target, or a CAD file.")],
    units: UnitsOption = None,
    longest_side_m: LongestOption = None,
    largest_file_mb: LargestFileOption = _LARGEST_FILE_MB,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for the page and its picture; the working folder by default."),
    ] = None,
    trials: Annotated[
        int | None,
        typer.Option(
            "--trials",
            help="Frames of each sensor on which methods are tried; by default 12, fewer if they take more "
            "than 20 s.",
            min=1,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Describe a target as rpod sees it, and draw it.

    It tells size, repairs, symmetries, the accuracy to expect by range, and how well methods find it.
    """
    if file.suffix or len(file.parts) > 1:  # no name
        _needs(file, "check")
    from rpod.target.command import check_command

    raise typer.Exit(
        check_command(
            file,
            units=units,
            longest_side_m=longest_side_m,
            largest_file_mb=largest_file_mb,
            trials=trials,
            out=out,
            as_json=as_json,
        )
    )


@target_verbs.command()
def errors(
    file: Annotated[Path, typer.Argument(help="Parameter file or name of a target.")],
    frames: Annotated[
        int, typer.Option("--frames", help="Emulated frames; more of them narrow the interval.", min=20)
    ] = 120,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the frames.", min=0)] = 1,
    write: Annotated[
        bool, typer.Option("--write", help="Write the result into the parameter file, as camera_errors.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure errors of a target's edges in images.

    The factor on the variance that a frame states follows from emulated frames, in which each part has
    another brightness. It takes half a minute to some minutes.
    """
    if file.suffix or len(file.parts) > 1:  # no name
        _needs(file, "errors")
    from rpod.target.errors_command import errors_command

    raise typer.Exit(errors_command(file, frames=frames, seed=seed, write=write, as_json=as_json))
