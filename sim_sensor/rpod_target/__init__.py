"""The target: shape, materials, wireframe, model points, distance field and mass properties.

A target is defined by a parameter file; some are shipped with the package. Building a target takes seconds
and needs Open3D. The result is cached by its digest, so that a service starts in milliseconds without Open3D.
"""

from rpod_target.equivalence import NO_SYMMETRY, Equivalence, Symmetry
from rpod_target.errors import TargetError
from rpod_target.joints import posed, shown
from rpod_target.loading import is_shipped, load_equivalence, load_target, shipped_targets
from rpod_target.shared_axes import check_model
from rpod_target.target import Albedo, DistanceField, Joint, Material, Target

__all__ = [
    "NO_SYMMETRY",
    "Albedo",
    "DistanceField",
    "Equivalence",
    "Joint",
    "Material",
    "Symmetry",
    "Target",
    "TargetError",
    "check_model",
    "is_shipped",
    "load_equivalence",
    "load_target",
    "posed",
    "shipped_targets",
    "shown",
]
