"""Optical properties that are proposed for a material of a mesh file, from its name and colour.

A colour says little about the reflectance at a laser's or a lamp's wavelength, so there are only five kinds.
The proposals are meant to be corrected by hand.

| kind | chosen by the name, else by the colour |
|---|---|
| foil | gold, kapton, mli, foil; a saturated yellow or orange |
| solar cells | solar, cell, array; a saturated or dark blue |
| metal | metal, steel, alu, titan; a metallic share of 0.5 and more |
| paint | a colour: reflectivity 0.1 to 0.8, with its brightness |
| unknown | no colour |
"""

import colorsys
import re
from typing import NamedTuple

import numpy as np

from rpod_target.mesh.files import FileMaterial
from rpod_target.parameters import MaterialParameters


class ProposedMaterial(NamedTuple):
    """A material for a target file."""

    parameters: MaterialParameters
    reason: str
    """Kind of the material, and why it was chosen."""


_FOIL = MaterialParameters(reflectivity=0.5, diffuse=0.12, f0=0.75, roughness=0.06, crinkle_deg=3.0)
_CELLS = MaterialParameters(reflectivity=0.175, diffuse=0.08, f0=0.04, roughness=0.1)
_METAL = MaterialParameters(reflectivity=0.4, diffuse=0.2, f0=0.5, roughness=0.3)
_UNKNOWN = MaterialParameters(reflectivity=0.35, diffuse=0.35, f0=0.02, roughness=0.3)
_NAMES = (
    (re.compile(r"gold|kapton|mli|foil|blanket", re.IGNORECASE), _FOIL, "foil"),
    (re.compile(r"solar|cell|array|photovolt", re.IGNORECASE), _CELLS, "solar cells"),
    (re.compile(r"metal|steel|alu|titan|chrome", re.IGNORECASE), _METAL, "metal"),
)
_BRIGHTNESS = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the brightness of a colour (ITU-R BT.709)."""


def proposed(material: FileMaterial) -> ProposedMaterial:
    """Return the material that is proposed for one of a mesh file."""
    for pattern, parameters, kind in _NAMES:
        if pattern.search(material.name):
            return ProposedMaterial(parameters, f"{kind}, by its name")
    if material.metallic is not None and material.metallic >= 0.5:
        return ProposedMaterial(_METAL, "metal, by its metallic share")
    if material.colour is None:
        return ProposedMaterial(_UNKNOWN, "unknown: the file gives no colour")
    hue, saturation, value = colorsys.rgb_to_hsv(*material.colour)
    if saturation > 0.5 and 0.07 < hue < 0.17 and value > 0.4:
        return ProposedMaterial(_FOIL, "foil, by its colour")
    if saturation > 0.5 and 0.55 < hue < 0.75:
        return ProposedMaterial(_CELLS, "solar cells, by its colour")
    brightness = float(_BRIGHTNESS @ material.colour)
    reflectivity = round(0.1 + 0.7 * brightness, 2)
    paint = MaterialParameters(
        reflectivity=reflectivity, diffuse=round(0.9 * reflectivity, 2), f0=0.04, roughness=0.4
    )
    return ProposedMaterial(paint, "paint, by its brightness")
