"""Differences between sensors' mounts, as the estimator's integrity states them (ICD section 3)."""

from collections.abc import Mapping
from math import isfinite

from rpod_schemas.summary import MountDifference

_PLACE, _TURN = ("x_m", "y_m", "z_m"), ("about_x_deg", "about_y_deg", "about_z_deg")
_START, _BETWEEN, _SIGMA = "mount_of_", "_from_", "_sigma_"


def mount_differences(evidence: Mapping[str, float]) -> dict[str, MountDifference]:
    """Return the differences that the evidence of an integrity message names, by ``<one> and <other>``."""
    last = _SIGMA + _PLACE[0]
    names = [name.removesuffix(last) for name in evidence if name.startswith(_START) and name.endswith(last)]
    found = {}
    for name in names:
        numbers = [
            tuple(evidence.get(f"{name}{part}{what}", float("nan")) for what in whats)
            for whats in (_PLACE, _TURN)
            for part in ("_", _SIGMA)
        ]
        other, _, one = name.removeprefix(_START).partition(_BETWEEN)
        if all(isfinite(each) for three in numbers for each in three):
            found[f"{one} and {other}"] = MountDifference.model_validate(
                dict(zip(MountDifference.model_fields, numbers, strict=True))
            )
    return found
