"""Layout of the screen: scene and images above, plots of the estimator below."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_view import palette

TIMELINE = "time"
CHASER = "chaser"
TRUTH, ESTIMATE = f"{CHASER}/truth", f"{CHASER}/estimate"
FOCUS = f"{CHASER}/focus"
"""Position of the target in the chaser's axes, at which the scene's eye looks."""
IMAGES = "image"
STATE = "state"
EVENTS = "events"
SUMMARY = "summary"
UNCERTAINTY = "uncertainty"
PLOTS = "plot"
POSITION, ATTITUDE, PROCESSING, RANGE = (
    f"{PLOTS}/{name}" for name in ("position", "attitude", "processing", "range")
)
_WINDOW_S = 30.0
"""Time span of the plots."""
_SCENE_RADII = 2.7
"""Distance of the eye from the target, in radii of the target."""
_UNCERTAINTY_RADII = 2.6
_Part = rrb.View | rrb.Container
Images = Mapping[str, Mapping[str, tuple[int, int]]]
"""Width and height of the images of each camera, by camera name and image title."""


@dataclass(frozen=True, eq=False)
class Eye:
    """Direction from which a scene is first seen; the view sets the distance."""

    offset: FloatArray
    """Unit vector from the centre of the scene to the eye, chaser axes, shape (3,)."""
    up: FloatArray
    """Upward direction of the picture, chaser axes, shape (3,)."""


def over_shoulder(T_chaser_sensor: RigidTransform) -> Eye:
    """Return an eye that sees the target like the sensor, but from a little to the right and above."""
    right, down, forward = T_chaser_sensor.rotation.as_matrix().T
    offset = 0.62 * right - 0.42 * down - 0.66 * forward
    return Eye(offset / np.linalg.norm(offset), -down)


def layout(images: Images, eye: Eye | None, radius_m: float) -> rrb.Blueprint:
    """Return the layout.

    Args:
        images: sizes of the images of each camera.
        eye: direction of the eye; None if the viewer chooses it.
        radius_m: radius of the target.
    """
    shown = [_image(name, title, size) for name, sizes in images.items() for title, size in sizes.items()]
    above: list[_Part] = [_scene(eye, radius_m)]
    if shown:
        above.append(rrb.Vertical(*shown))
    above.append(rrb.Vertical(rrb.TextDocumentView(origin=SUMMARY, name="Navigator"), _uncertainty(eye)))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*above, column_shares=[10, 6, 4] if shown else [10, 4]),
            rrb.Horizontal(_history(), *_plots(), column_shares=[4, 4, 4, 3]),
            row_shares=[5, 3],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_layout=False,
        auto_views=False,
    )


def _scene(eye: Eye | None, radius_m: float) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=FOCUS,
        contents=f"{CHASER}/**",
        name="Scene: the target's truth in grey, its estimate in red",
        background=palette.BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=_controls(eye, _SCENE_RADII * radius_m),
    )


def _uncertainty(eye: Eye | None) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=UNCERTAINTY,
        name="Truth (white) in the estimate's 3 sigma",
        background=palette.BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=_controls(eye, _UNCERTAINTY_RADII),
    )


def _controls(eye: Eye | None, distance: float) -> rrb.EyeControls3D | None:
    if eye is None:
        return None
    return rrb.EyeControls3D(position=distance * eye.offset, look_target=(0.0, 0.0, 0.0), eye_up=eye.up)


def _image(camera: str, title: str, size: tuple[int, int]) -> rrb.Spatial2DView:
    width, height = size
    return rrb.Spatial2DView(
        origin=f"{IMAGES}/{camera}/{title}",
        name=f"{camera} {title}, wireframe at the estimate",
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, width), y_range=(0.0, height)),
    )


def _history() -> rrb.Vertical:
    columns = rrb.TextLogColumns(text_log_columns=[TextLogColumn("LogLevel"), TextLogColumn("Body")])
    return rrb.Vertical(
        rrb.StateTimelineView(origin=STATE, name="State"),
        rrb.TextLogView(origin=EVENTS, name="Events", columns=columns),
    )


def _plots() -> list[_Part]:
    return [
        _plot(POSITION, "Position error, mm"),
        _plot(ATTITUDE, "Attitude error, deg"),
        rrb.Tabs(_plot(PROCESSING, "Processing, ms"), _plot(RANGE, "Range, m"), active_tab=0),
    ]


def _plot(origin: str, name: str) -> rrb.TimeSeriesView:
    recent = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_WINDOW_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.TimeSeriesView(
        origin=origin, name=name, time_ranges=recent, plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop)
    )
