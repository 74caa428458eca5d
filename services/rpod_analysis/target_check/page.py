"""Picture and page of a target: views with their visible edges, and the numbers of the check."""

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.target_check.check import TargetCheck
from rpod_geometry.rays import RayGrid, cast
from rpod_geometry.wireframe import project
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_target import Target

_SIDE = 420
_FOCAL = 2.2 * _SIDE
"""Side of a view and focal length, pixels: the target fills most of it from 2.6 radii."""
_AWAY = 2.5
_PAPER, _LINE = 255, (40, 40, 200)
_SHADES = {"dark": 0.35, "grey": 0.6, "white": 0.95, "mirror": 0.8}
_PIECES = 16
"""Number of pieces of an edge; each is drawn or hidden as a whole."""
_SLACK = 0.01
"""Depth, over the radius, by which an edge may lie behind the surface that it bounds."""
_VIEWS = (
    ("from +x", (1.0, 0.0, 0.0)),
    ("from +y", (0.0, 1.0, 0.0)),
    ("from +z", (0.0, 0.0, 1.0)),
    ("from -x, -y, +z", (-1.0, -1.0, 0.8)),
    ("from +x, +y, +z", (1.0, 1.0, 0.8)),
    ("from -x, +y, -z", (-1.0, 1.0, -0.8)),
)


@dataclass(frozen=True)
class CheckFiles:
    """Files that a check writes."""

    page: Path
    picture: Path


def write_page(target: Target, check: TargetCheck, out: Path) -> CheckFiles:
    """Write ``NAME-check.html`` and ``NAME-check.png`` into a folder. Raises ``OSError``."""
    out.mkdir(parents=True, exist_ok=True)
    picture, page = out / f"{target.name}-check.png", out / f"{target.name}-check.html"
    encoded = cv2.imencode(".png", render_views(target))[1].tobytes()
    picture.write_bytes(encoded)
    environment = Environment(
        loader=PackageLoader("rpod_analysis"), undefined=StrictUndefined, autoescape=True
    )
    image = "data:image/png;base64," + base64.b64encode(encoded).decode()
    page.write_text(environment.get_template("target.html.j2").render(check=check, image=image), "utf-8")
    return CheckFiles(page, picture)


def render_views(target: Target) -> NDArray[np.uint8]:
    """Return six views of a target with its visible edges, shape (rows, columns, 3)."""
    views = [_view(target, title, np.array(towards)) for title, towards in _VIEWS]
    return np.vstack([np.hstack(views[:3]), np.hstack(views[3:])])


def _view(target: Target, title: str, from_direction: FloatArray) -> NDArray[np.uint8]:
    half = (_SIDE - 1) / 2.0
    camera = Camera(width=_SIDE, height=_SIDE, fx=_FOCAL, fy=_FOCAL, cx=half, cy=half)
    grid = RayGrid.pinhole(camera)
    low_m, high_m = target.triangles_m.min(axis=(0, 1)), target.triangles_m.max(axis=(0, 1))
    radius_m = 0.5 * float(np.linalg.norm(high_m - low_m))
    pose = _looking(from_direction, 0.5 * (low_m + high_m), _AWAY * 2.0 * radius_m)
    hits = cast(grid, target.triangles_m, pose, cull_back_faces=True)
    triangle = np.maximum(hits.triangle, 0)
    normals = pose.rotation.apply(target.normals)[triangle]
    cosine = np.abs(np.einsum("rci,rci->rc", normals, grid.directions))
    albedo = np.array([_SHADES[material.looks] for material in target.materials])
    shade = 255.0 * albedo[target.triangle_material[triangle]] * (0.25 + 0.75 * cosine)
    grey = np.where(hits.triangle >= 0, shade, _PAPER).astype(np.uint8)
    image = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)
    depth_m = hits.range_m * grid.components[2]
    lines = _visible(target, pose, camera, depth_m, slack_m=_SLACK * radius_m)
    cv2.polylines(image, list(np.round(8.0 * lines).astype(np.int32)), False, _LINE, 1, cv2.LINE_AA, 3)
    cv2.putText(image, title, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (90, 90, 90), 1, cv2.LINE_AA)
    return image


def _looking(from_direction: FloatArray, centre_m: FloatArray, distance_m: float) -> RigidTransform:
    """Return T_sensor_target of a camera that looks at a place, with z of the target up."""
    forward = -from_direction / np.linalg.norm(from_direction)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.95 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = Rotation.from_matrix(np.stack([right, np.cross(forward, right), forward]))
    return make_pose(
        rotation=rotation, translation_m=np.array([0.0, 0.0, distance_m]) - rotation.apply(centre_m)
    )


def _visible(
    target: Target, pose: RigidTransform, camera: Camera, depth_m: FloatArray, *, slack_m: float
) -> FloatArray:
    """Return the pieces of the wireframe that no surface hides, pixels, shape (N, 2, 2)."""
    knots = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    ends = pose.apply(target.edges_m.reshape(-1, 3)).reshape(-1, 2, 3)
    points = ends[:, None, 0] + knots * (ends[:, None, 1] - ends[:, None, 0])
    pieces = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)
    middle = pieces.mean(axis=1)
    column, row = np.round(project(middle, camera)).astype(np.int64).T
    within = (column > 0) & (column < _SIDE - 1) & (row > 0) & (row < _SIDE - 1)
    pieces, middle, row, column = pieces[within], middle[within], row[within], column[within]
    behind = np.max([depth_m[row + r, column + c] for r in (-1, 0, 1) for c in (-1, 0, 1)], axis=0)
    shown: FloatArray = project(pieces[middle[:, 2] < behind + slack_m], camera)
    return shown
