"""A frame as a picture: depth and amplitude, with the target's wireframe over them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
import polars as pl
from plotly.subplots import make_subplots
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.report.figures import QUIET
from rpod_analysis.report.snapshots import Picture, frame_pictures
from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import COLOURS, with_legend
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.pmd.scene import Shot, Stage, scenario_of
from rpod_campaign.pmd.sequence import FRAME, SequenceCell
from rpod_geometry.wireframe import project, visible_pieces
from rpod_schemas.arrays import FloatArray

_HEIGHT_PX = 460


def picture(results: Sequence[CellResult[SequenceCell]], *, number: int) -> go.Figure:
    """Return a frame of the first trial, with the wireframes at all the results' estimates.

    Args:
        results: results of one scenario and world, at least one.
        number: number of the frame, from zero.
    """
    shot, rows = _shot(results[0], number), [_row(result, number) for result in results]
    target = cached_target(scenario_of(results[0].cell.document).target)
    camera = shot.frame.camera

    def outline(pose: RigidTransform) -> FloatArray:
        return project(visible_pieces(target, pose), camera)

    truth = outline(shot.T_sensor_target)
    shown = frame_pictures(shot.frame, truth.reshape(-1, 2))
    figure = make_subplots(
        1, len(shown), subplot_titles=[f"{each.title}, image {number + 1}" for each in shown],
        horizontal_spacing=0.03,
    )  # fmt: skip
    for column, each in enumerate(shown, start=1):
        _draw(figure, each, column=column)
        _trace(figure, truth, "truth", QUIET, column=column)
        for index, (result, row) in enumerate(zip(results, rows, strict=True)):
            name = f"{result.cell.method}: {row['attitude_deg']:.2f} deg, {1e2 * row['position_m']:.1f} cm"
            colour = COLOURS[index % len(COLOURS)]
            _trace(figure, outline(_pose(row["found"])), name, colour, column=column)
    return with_legend(figure, height=_HEIGHT_PX).update_layout(legend={"y": -0.02, "yanchor": "top"})


def _shot(result: CellResult[SequenceCell], number: int) -> Shot:
    row, cell = _row(result, number), result.cell
    stage = Stage(scenario_of(cell.document), cell.world, seed=row["seed"], trial=row["trial"])
    return stage.take(row["time_s"])


def _row(result: CellResult[SequenceCell], number: int) -> dict[str, Any]:
    wanted = (pl.col(FRAME) == number) & (pl.col("trial") == 0)
    return result.rows.row(by_predicate=wanted, named=True)


def _pose(numbers: list[float]) -> RigidTransform:
    return RigidTransform.from_components(np.array(numbers[:3]), Rotation.from_quat(numbers[3:]))


def _draw(figure: go.Figure, shown: Picture, *, column: int) -> None:
    """Add an image to a subplot whose axes are its pixels, cropped to the picture's window."""
    left, top, width, height = shown.view
    across, down = shown.size
    figure.add_layout_image(
        source=shown.image, x=-0.5, y=-0.5, sizex=across, sizey=down, xanchor="left", yanchor="top",
        sizing="stretch", layer="below", row=1, col=column,
    )  # fmt: skip
    quiet: dict[str, Any] = {"showgrid": False, "zeroline": False, "showticklabels": False}
    figure.update_xaxes(quiet | {"range": (left, left + width), "constrain": "domain"}, row=1, col=column)
    square = {"scaleanchor": "x" if column == 1 else f"x{column}", "constrain": "domain"}
    figure.update_yaxes(quiet | square | {"range": (top + height, top)}, row=1, col=column)


def _trace(figure: go.Figure, segments: FloatArray, name: str, colour: str, *, column: int) -> None:
    """Draw segments, shape (N, 2, 2), as one line with gaps."""
    gaps = np.full((len(segments), 1, 2), np.nan)
    points = np.concatenate((segments, gaps), axis=1).reshape(-1, 2)
    figure.add_trace(
        go.Scatter(
            x=points[:, 0], y=points[:, 1], mode="lines", name=name, legendgroup=name,
            showlegend=column == 1, line={"color": colour, "width": 1.4}, hoverinfo="skip",
        ),
        row=1,
        col=column,
    )  # fmt: skip
