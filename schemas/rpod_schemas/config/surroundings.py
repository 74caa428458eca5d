"""Things in a scenario beside the target: walls, a stand, the arm that holds it, a plate before it."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from rpod_schemas.config.base import Config, Name, NonNegative, Positive, Share
from rpod_schemas.poses import Pose, make_pose
from rpod_schemas.topics import CHASER


class _Thing(Config):
    fixed_to: Literal["chaser", "target"] = "chaser"
    """Body with which the thing moves: the chaser, whose laboratory stands still, or the target, such as the
    arm that holds it."""
    pose: Pose = Field(default_factory=make_pose)
    """Pose of the thing's own axes in those of the body."""
    reflectance: Share = 0.4
    """Diffuse reflectance at the wavelengths of both sensors."""


class BoxThing(_Thing):
    """A cuboid about its own origin; a sensor inside it sees a room."""

    kind: Literal["box"]
    """Selects a cuboid."""
    size_m: tuple[Positive, Positive, Positive]
    """Full lengths along x, y, z, m."""


class CylinderThing(_Thing):
    """A circular cylinder along x, such as a limb of an arm."""

    kind: Literal["cylinder"]
    """Selects a cylinder."""
    radius_m: Positive
    """Radius, m."""
    length_m: Positive
    """Length along x, from 0, m."""


class MeshThing(_Thing):
    """The surface of a CAD or mesh file."""

    kind: Literal["mesh"]
    """Selects a file."""
    file: str
    """Path of the file: STL, OBJ, PLY, glTF or GLB; relative to the working directory."""
    metres_per_unit: Positive = 1.0
    """Scale of the file's coordinates."""


Thing = Annotated[BoxThing | CylinderThing | MeshThing, Field(discriminator="kind")]
"""A thing that sensors see beside the target; ``kind`` chooses its shape."""


Line = Annotated[int, Field(ge=0)]
"""Number of a row or a column, counted from 0."""


class SensorSurroundings(Config):
    """Known surroundings of a sensor."""

    range_gate_m: tuple[NonNegative, Positive] | None = None
    """Least and greatest range that may be the target's, m."""
    mask: Path | None = None
    """Image of the frame's size (PNG): black pixels are not used; relative to this file."""
    dead_rows: tuple[Line, ...] = ()
    """Rows of the sensor's frames that never measure, counted from 0, such as dead channels of a scanner.
    Their rays carry no information; without this entry they count as misses of the target."""
    dead_columns: tuple[Line, ...] = ()
    """Columns that never measure, counted from 0."""
    background: Path | None = None
    """View of the sensor without the target, written by ``rpod calibrate background``; relative to this
    file."""


class KnownBody(Config):
    """A body beside the target whose shape and pose are known, such as a limb of the robot that holds it."""

    file: Path
    """CAD or mesh file of its surface: STL, OBJ, PLY, glTF or GLB; relative to this file. Its triangles are
    rendered for each frame: some thousands are enough."""
    metres_per_unit: Positive
    """Scale of the file's coordinates: 0.001 for millimetres."""
    frame: Name = CHASER
    """Frame in which ``pose`` is given. ``chaser`` is for a body that stands still before the sensors; the
    pose of any other frame is read from ``bodies/<frame>/odometry``, published by the robot's controller."""
    pose: Pose = Field(default_factory=make_pose)
    """Pose of the file's axes in the frame."""
    tolerance_m: Positive = 0.05
    """Largest distance by which its surface may be off, m: errors of shape and pose, and of the sensors'
    ranges. What is seen this close to it is taken for it."""


class KnownSurroundings(Config):
    """A file of what is known of the sensors' surroundings, which the estimator takes."""

    sensors: dict[Name, SensorSurroundings] = Field(default_factory=dict)
    """Known surroundings, by the sensor's name."""
    bodies: dict[Name, KnownBody] = Field(default_factory=dict)
    """Bodies that all sensors may see, by name."""
