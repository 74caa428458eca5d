"""The reflectance against its limits: Lambert, the peak of the lobe, reciprocity, energy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpod_sim_sensor.pmd.reflection import reflected_share

cosines = st.floats(0.01, 1.0)


@settings(deadline=None)  # the first call compiles
@given(n_l=cosines, n_v=cosines)
def test_without_a_specular_part_a_surface_is_lambertian(n_l: float, n_v: float) -> None:
    lobe_at_grazing = 1e-3  # Schlick's term is 1 at grazing incidence even for f0 = 0
    share = reflected_share(n_l, n_v, 1.0, 0.4, 0.0, 0.01)
    assert share == pytest.approx(0.4 / math.pi * n_l, rel=lobe_at_grazing)


def test_the_lobe_peaks_where_the_camera_looks_along_the_normal() -> None:
    alpha2, f0 = 0.2**4, 0.75
    assert reflected_share(1.0, 1.0, 1.0, 0.0, f0, alpha2) == pytest.approx(f0 / (4 * math.pi * alpha2))
    off = math.cos(2 * 0.2**2)  # twice the lobe's width
    assert reflected_share(off, off, 1.0, 0.0, f0, alpha2) < 0.05 * f0 / (4 * math.pi * alpha2)


@settings(deadline=None)  # the first call compiles
@given(n_l=cosines, n_v=cosines, azimuth=st.floats(0, math.pi), roughness=st.floats(0.1, 1.0))
def test_light_and_viewer_can_be_exchanged(n_l: float, n_v: float, azimuth: float, roughness: float) -> None:
    across = math.sqrt((1 - n_l**2) * (1 - n_v**2))
    l_v = n_l * n_v + across * math.cos(azimuth)
    there = reflected_share(n_l, n_v, l_v, 0.2, 0.5, roughness**4) / n_l
    back = reflected_share(n_v, n_l, l_v, 0.2, 0.5, roughness**4) / n_v
    assert there == pytest.approx(back, rel=1e-9)


def test_at_grazing_incidence_every_surface_becomes_a_mirror() -> None:
    dull, mirror = (reflected_share(0.05, 0.05, -0.99, 0.0, f0, 0.01) for f0 in (0.02, 1.0))
    assert dull / mirror == pytest.approx(0.02 + 0.98 * (1 - math.sqrt(0.005)) ** 5)


def reflected_of_all(n_v: float, roughness: float, cells: int = 200) -> float:
    """What a perfect mirror of facets sends on of light from everywhere (the white furnace)."""
    n_l = (np.arange(cells) + 0.5) / cells
    azimuth = n_l * math.pi
    total = 0.0
    for cosine in n_l:
        l_v = cosine * n_v + math.sqrt((1 - cosine**2) * (1 - n_v**2)) * np.cos(azimuth)
        total += sum(reflected_share(cosine, n_v, value, 0.0, 1.0, roughness**4) for value in l_v)
    return total / cells**2 * 2 * math.pi


@pytest.mark.parametrize("n_v", [0.3, 0.7, 0.99])
def test_no_surface_reflects_more_than_it_receives(n_v: float) -> None:
    smooth, rough, rougher = (reflected_of_all(n_v, roughness) for roughness in (0.4, 0.7, 1.0))
    assert 0.85 < smooth < 1.005
    assert rougher < rough < smooth  # what facets mask is lost: the model has one bounce


def test_the_roughest_surface_reflects_what_its_integral_says() -> None:
    assert reflected_of_all(1.0, 1.0) == pytest.approx(1 - math.log(2), rel=1e-3)
