"""Turns by which the facets of a nearly round target come to lie on their neighbours.

CAD has flat facets where a body is round. An alignment that is some degrees off about the axis ends at the
neighbouring facet, which fits as well if the parts that tell the turn are hidden. So these turns are rivals
of an alignment (``alternatives``), whose distances are in its covariance.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.mesh.topology import areas_m2

FEWEST, MOST = 12, 128
"""Least and largest number of facets around an axis. Physics: a body of fewer has edges that are seen, and
the next turn of one of more is below 3 deg."""
REGULAR = 0.5
"""Least regularity of the normals at an order, over the largest one, for it to be the number of facets.
Numerics: the halves of a facet are regular at twice its order too, and flat parts on one side reduce it."""
STEPS = (-1, 1, -2, 2)
"""Facets by which a start is turned. Numerics: a budget; the covariance of two facets to each side tells that
the turn is open."""


def facet_turns(target: Target) -> FloatArray:
    """Return the turns about nearly round axes of a target, target axes, shape (N, 3, 3)."""
    axes = [
        np.array(each.axis)
        for each in target.symmetries
        if not each.exact and (each.continuous or each.order >= FEWEST)
    ]
    facets = [_facet_rad(target, axis) * axis for axis in axes]
    turns = [step * facet for facet in facets for step in STEPS]
    return Rotation.from_rotvec(np.array(turns).reshape(-1, 3)).as_matrix()


def turned_states(turns: FloatArray, state: State) -> list[State]:
    """Return a state turned about the target's own axes."""
    (R, t), bias_m = state
    return [State(PoseArrays(R @ turn, t), bias_m) for turn in turns]


def _facet_rad(target: Target, axis: FloatArray) -> float:
    """Return the angle between two facets: that at which the normals of most of the area are regular."""
    along = target.normals @ axis
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    angle_rad = np.arctan2(target.normals @ second, target.normals @ first)
    area = areas_m2(target.triangles_m) * np.sqrt(np.maximum(1.0 - along**2, 0.0))
    orders = np.arange(FEWEST, MOST + 1)
    regular = np.array([np.abs(np.exp(1j * order * angle_rad) @ area) for order in orders])
    return float(2.0 * np.pi / orders[np.argmax(regular > REGULAR * regular.max())])
