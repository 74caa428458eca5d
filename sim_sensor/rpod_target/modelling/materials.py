"""Materials of random satellites and shipped designs: foils, bare metals, paints, solar cells.

The values are assumed, around those of the laboratory's mock-up.
"""

from collections.abc import Mapping

from rpod_target.parameters import MaterialParameters

MATERIALS: Mapping[str, MaterialParameters] = {
    "gold-mli": MaterialParameters(
        reflectivity=0.5, diffuse=0.12, f0=0.75, roughness=0.06, crinkle_deg=3.0, albedo="mirror"
    ),
    "silver-mli": MaterialParameters(
        reflectivity=0.5, diffuse=0.10, f0=0.85, roughness=0.04, crinkle_deg=3.0, albedo="mirror"
    ),
    "black-mli": MaterialParameters(
        reflectivity=0.12, diffuse=0.06, f0=0.1, roughness=0.15, crinkle_deg=3.0, albedo="dark"
    ),
    "aluminium": MaterialParameters(reflectivity=0.5, diffuse=0.25, f0=0.6, roughness=0.25, albedo="mirror"),
    "steel": MaterialParameters(reflectivity=0.4, diffuse=0.2, f0=0.5, roughness=0.3, albedo="mirror"),
    "white-paint": MaterialParameters(reflectivity=0.75, diffuse=0.7, f0=0.04, roughness=0.4, albedo="white"),
    "grey-panel": MaterialParameters(reflectivity=0.35, diffuse=0.35, f0=0.02, roughness=0.3, albedo="grey"),
    "black-paint": MaterialParameters(reflectivity=0.1, diffuse=0.08, f0=0.04, roughness=0.3, albedo="dark"),
    "solar-cells": MaterialParameters(
        reflectivity=0.175, diffuse=0.08, f0=0.04, roughness=0.1, albedo="dark"
    ),
}
"""Materials by name."""
