"""Mass properties of bodies whose moments are known."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rpod_target.build.mass import mass_properties

TURN = Rotation.from_rotvec([0.3, -0.8, 0.5])
AT_M = np.array([12.0, -7.0, 3.0])
NOTHING = np.zeros((0, 3, 3))


def placed(mesh: trimesh.Trimesh) -> np.ndarray:
    return TURN.apply(np.array(mesh.triangles).reshape(-1, 3)).reshape(-1, 3, 3) + AT_M


def turned(moments: list[float]) -> np.ndarray:
    return TURN.as_matrix() @ np.diag(moments) @ TURN.as_matrix().T


def test_a_tilted_brick_has_the_moments_of_a_brick() -> None:
    brick = placed(trimesh.creation.box((3.0, 1.5, 1.0)))
    found = mass_properties(brick, brick, mass_kg=12.0, density_kg_m3=None, spread="volume")
    np.testing.assert_allclose(found.centre_m, AT_M, atol=1e-9)
    np.testing.assert_allclose(found.inertia_kg_m2, turned([3.25, 10.0, 11.25]), atol=1e-9)


def test_a_tilted_sheet_has_the_moments_of_a_sheet() -> None:
    corners = np.array([[0, 0, 0], [3, 0, 0], [3, 2, 0], [0, 2, 0]]) - [1.5, 1.0, 0.0]
    sheet = placed(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]))
    found = mass_properties(NOTHING, sheet, mass_kg=12.0, density_kg_m3=None, spread="volume")
    np.testing.assert_allclose(found.centre_m, AT_M, atol=1e-9)
    np.testing.assert_allclose(found.inertia_kg_m2, turned([4.0, 9.0, 13.0]), atol=1e-9)


def test_a_ball_and_its_skin_differ() -> None:
    ball = placed(trimesh.creation.icosphere(subdivisions=5))
    solid, skin = (
        mass_properties(ball, ball, mass_kg=5.0, density_kg_m3=None, spread=spread)
        for spread in ("volume", "surface")
    )
    np.testing.assert_allclose(np.linalg.eigvalsh(solid.inertia_kg_m2), 2.0, rtol=2e-3)
    np.testing.assert_allclose(np.linalg.eigvalsh(skin.inertia_kg_m2), 10.0 / 3.0, rtol=2e-3)


def test_a_density_gives_the_mass_of_the_solid_to_its_skin() -> None:
    brick = placed(trimesh.creation.box((3.0, 1.5, 1.0)))
    for spread in ("volume", "surface"):
        found = mass_properties(brick, brick, mass_kg=None, density_kg_m3=2.0, spread=spread)
        assert found.mass_kg == pytest.approx(9.0)
