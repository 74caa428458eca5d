"""Things that a sensor sees besides the target: rays meet them, but the truth does not contain them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.surroundings import BoxThing, CylinderThing, MeshThing, Thing
from rpod_sim_sensor.errors import SimSensorError
from rpod_target import Material, Target
from rpod_target.build.surfaces import box_surface, cylinder_surface
from rpod_target.mesh.folder import surface_m
from rpod_target.mesh.topology import unit_normals
from rpod_target.parameters import BoxParameters, CylinderParameters
from rpod_target.target import Int32Array

_F0, _ROUGHNESS = 0.04, 0.6
"""Specular reflectance and roughness of paint; assumed."""


class MeshOfSurroundingsError(SimSensorError):
    """A mesh file of the surroundings cannot be used."""

    def __init__(self, file: str, reason: str) -> None:
        super().__init__(f"surroundings: mesh {file}: {reason}")


@dataclass(frozen=True, eq=False)
class Scenery:
    """The target with the things that are fixed to it, and the things that are fixed to the sensor."""

    moving: Target
    """The target; its surface includes the things that are fixed to it."""
    still_m: FloatArray
    """Triangles that are fixed to the chaser, sensor axes, shape (S, 3, 3)."""
    still_normals: FloatArray
    """Their unit normals, shape (S, 3)."""
    still_material: Int32Array
    """Their materials, indices into those of ``moving``, shape (S,)."""

    @property
    def is_closed(self) -> bool:
        """Whether no triangle is seen from behind, so that triangles that face away may be left out."""
        return self.moving.field is not None


def scenery(target: Target, things: Sequence[Thing], T_chaser_sensor: RigidTransform) -> Scenery:
    """Return what a sensor sees: the target and the things around it.

    Raises:
        MeshOfSurroundingsError: a mesh file cannot be read.
    """
    materials = list(target.materials)
    with_target: list[FloatArray] = [target.triangles_m]
    still: list[FloatArray] = [np.empty((0, 3, 3))]
    of_moving, of_still = [target.triangle_material], [np.empty(0, np.int32)]
    for thing in things:
        number = np.int32(len(materials))
        materials.append(
            Material("surroundings", thing.reflectance, thing.reflectance, f0=_F0, roughness=_ROUGHNESS)
        )
        pose = thing.pose if thing.fixed_to == "target" else T_chaser_sensor.inv() * thing.pose
        corners_m = _surface_m(thing)
        triangles_m: FloatArray = pose.apply(corners_m.reshape(-1, 3)).reshape(corners_m.shape)
        chosen, kinds = (with_target, of_moving) if thing.fixed_to == "target" else (still, of_still)
        chosen.append(triangles_m)
        kinds.append(np.full(len(triangles_m), number))
    moving = target
    if materials[len(target.materials) :]:
        triangles_m = np.concatenate(with_target)
        moving = replace(
            target,
            triangles_m=triangles_m,
            normals=np.concatenate((target.normals, unit_normals(triangles_m[len(target.normals) :]))),
            triangle_material=np.concatenate(of_moving),
            materials=tuple(materials),
            field=target.field if len(with_target) == 1 else None,
        )
    still_m = np.concatenate(still)
    return Scenery(moving, still_m, unit_normals(still_m), np.concatenate(of_still))


def _surface_m(thing: Thing) -> FloatArray:
    """Return the triangles of a thing in its own axes, shape (T, 3, 3), m."""
    if isinstance(thing, BoxThing):
        return box_surface(
            BoxParameters(name="thing", material="", shape="box", size_m=thing.size_m)
        ).triangles_m
    if isinstance(thing, CylinderThing):
        return cylinder_surface(
            CylinderParameters(
                name="thing",
                material="",
                shape="cylinder",
                radius_m=thing.radius_m,
                length_m=thing.length_m,
            )
        ).triangles_m
    return _mesh_m(thing)


def _mesh_m(thing: MeshThing) -> FloatArray:
    try:
        return surface_m(Path(thing.file), thing.metres_per_unit)
    except (OSError, ValueError) as error:
        raise MeshOfSurroundingsError(thing.file, str(error)) from error
