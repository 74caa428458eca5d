"""``rpod calibrate``: what a laboratory calibrates, each from its logs."""

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from rpod.options import JsonOption, NoLimits


class _WithOldForm(TyperGroup):
    """Verbs of ``rpod calibrate``; ``rpod calibrate LOG`` still means ``rpod calibrate depth LOG``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put ``depth`` before arguments that do not begin with a verb, and print a remark."""
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            print("rpod calibrate: 'rpod calibrate LOG' is now 'rpod calibrate depth LOG'", file=sys.stderr)
            args = ["depth", *args]
        return super().parse_args(ctx, args)


calibrate_verbs = typer.Typer(cls=_WithOldForm, no_args_is_help=True, rich_markup_mode=None)

LogArgument = Annotated[
    Path, typer.Argument(help="MCAP file, or folder, with the sensor's frames and the truth.")
]
SensorOption = Annotated[
    str | None, typer.Option("--sensor", help="Name of the sensor; needed if the log has several.")
]
ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", help="Estimator that measures the poses; by default the one in the log."),
]
DepthSigmaOption = Annotated[
    float | None,
    typer.Option(
        "--depth-sigma-mm",
        min=0.0,
        help="How far the sensor's distances may be off, mm; by default what the estimator assumes of it.",
    ),
]
OutOption = Annotated[Path | None, typer.Option("--out", help="File to write.")]


@calibrate_verbs.callback()
def calibrate() -> None:
    """Calibrate distances, background, mount, clock or lens."""


@calibrate_verbs.command()
def depth(
    logs: Annotated[list[Path], typer.Argument(help="MCAP files with a PMD camera's frames and the truth.")],
    camera: Annotated[str, typer.Option("--camera", help="Name of the camera.")] = "pmd",
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            help="Estimator with the target, the camera's mount and frequency; by default those in the log.",
        ),
    ] = None,
    check: Annotated[
        Path | None, typer.Option("--check", help="Calibration to check on the logs, instead of a fit.")
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
    _no_limits: NoLimits = False,
) -> None:
    """Find the errors of a PMD camera's distances.

    These are an offset and the wiggling. It writes <camera>-calibration.yaml.
    """
    from rpod.calibrate.depth import calibrate_command

    raise typer.Exit(
        calibrate_command(logs, camera=camera, config=config, check=check, out=out, as_json=as_json)
    )


@calibrate_verbs.command()
def background(
    log: Annotated[Path, typer.Argument(help="MCAP file, or folder, of frames without the target.")],
    out: OutOption = None,
    as_json: JsonOption = False,
    _no_limits: NoLimits = False,
) -> None:
    """Learn what each sensor sees without the target. It writes surroundings.yaml."""
    from rpod.calibrate.background import background_command

    raise typer.Exit(background_command(log, out=out, as_json=as_json))


def _add_hand_eye(verb: Literal["mount", "clock"], does: str) -> None:
    """Add a verb that compares the poses that a sensor measured with the truth."""

    def find(
        log: LogArgument,
        sensor: SensorOption = None,
        config: ConfigOption = None,
        depth_sigma_mm: DepthSigmaOption = None,
        out: OutOption = None,
        as_json: JsonOption = False,
        _no_limits: NoLimits = False,
    ) -> None:
        from rpod.calibrate.hand_eye import hand_eye_command

        raise typer.Exit(
            hand_eye_command(
                verb, log, sensor, config=config, depth_sigma_mm=depth_sigma_mm, out=out, as_json=as_json
            )
        )

    calibrate_verbs.command(verb, help=does)(find)


_add_hand_eye("mount", "Find the mount of a sensor in the chaser (hand-eye). It writes <sensor>-mount.yaml.")
_add_hand_eye("clock", "Find offset and drift of a sensor's clock. It writes <sensor>-source.yaml.")


@calibrate_verbs.command()
def camera(
    images: Annotated[
        Path, typer.Argument(help="MCAP file with a PMD camera's amplitude images, or folder of PNG images.")
    ],
    pattern: Annotated[str, typer.Option("--pattern", help="Inner corners of the checkerboard, as 9x6.")],
    square_mm: Annotated[float, typer.Option("--square-mm", min=0.1, help="Side of a square, mm.")],
    sensor: Annotated[str, typer.Option("--sensor", help="Name of the camera, for a log.")] = "pmd",
    model: Annotated[
        str, typer.Option("--model", help="Lens: plumb_bob, or rational_polynomial for wide lenses.")
    ] = "plumb_bob",
    out: OutOption = None,
    as_json: JsonOption = False,
    _no_limits: NoLimits = False,
) -> None:
    """Find the intrinsics of a camera from a checkerboard. It writes <sensor>-camera.yaml."""
    from rpod.calibrate.intrinsics import camera_command

    raise typer.Exit(
        camera_command(
            images, pattern=pattern, square_mm=square_mm, sensor=sensor, model=model, out=out, as_json=as_json
        )
    )
