"""More rays in some pixels meet what rays through the whole target meet."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rpod_geometry.finer_rays import SAMPLES, Surface, finer_hits
from rpod_geometry.kernels import kernel
from rpod_geometry.rays import Hits, RayGrid, cast
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_target.mesh.topology import beyond_sides

CAMERA = Camera(width=48, height=40, fx=60.0, fy=60.0, cx=23.5, cy=19.5, distortion=(-0.1, 0.02, 0.0, 0.0))


@kernel
def hits_of(rays, triangle, per_px, pixels, surface):
    """Call the inner kernel."""
    found = finer_hits(rays, triangle, per_px, pixels, surface)
    return found.triangle, found.inverse


def every_ray() -> RayGrid:
    """Return all rays of all pixels, those of a pixel side by side, by their exact directions."""
    grid = RayGrid.pinhole(CAMERA, SAMPLES**2)
    number = np.arange(SAMPLES**2)
    across = number % SAMPLES * SAMPLES + number // SAMPLES
    rows = SAMPLES**2 * np.arange(CAMERA.height)[:, None, None] + number
    columns = SAMPLES**2 * np.arange(CAMERA.width)[:, None] + across
    rays = grid.components[:, rows, columns]
    return RayGrid(np.ascontiguousarray(rays.reshape(3, CAMERA.height, -1)))


@pytest.mark.parametrize("per_px", [1, 2])
@pytest.mark.parametrize(
    ("mesh", "alike"),
    [
        (trimesh.creation.box((1.0, 0.8, 0.6)), 0.999),
        (trimesh.creation.icosphere(subdivisions=3), 0.995),  # facets of half a pixel
        (trimesh.creation.cylinder(radius=0.03, height=2.0, sections=12), 0.97),  # a rod of one pixel
    ],
    ids=["box", "sphere", "rod"],
)
def test_rays_of_a_pixel_meet_what_rays_through_the_whole_target_meet(mesh, alike, per_px):
    triangles_m = np.ascontiguousarray(mesh.triangles)
    pose = make_pose(rotation=Rotation.from_rotvec((0.4, 0.7, 0.2)), translation_m=(0.1, -0.05, 3.0))
    coarse_rays = RayGrid.pinhole(CAMERA, per_px).in_single_precision()
    coarse = cast(coarse_rays, triangles_m, pose, cull_back_faces=True)
    surface = Surface(
        triangles_m, beyond_sides(triangles_m), pose.rotation.as_matrix(), np.array(pose.translation)
    )
    pixels = np.stack(np.indices((CAMERA.height, CAMERA.width)), axis=-1).reshape(-1, 2).astype(np.int32)
    triangle, inverse = hits_of(coarse_rays.components, coarse.triangle, per_px, pixels, surface)
    grid = every_ray()
    exact = cast(grid, triangles_m, pose, out=Hits.of(grid), cull_back_faces=True)
    met = exact.triangle.reshape(triangle.shape)
    near = np.zeros(CAMERA.height * CAMERA.width, bool)  # pixels around which a coarse ray meets the target
    shown = np.pad(coarse.triangle >= 0, 1)
    for i in range(per_px + 2):
        for j in range(per_px + 2):
            near |= shown[i::per_px, j::per_px][: CAMERA.height, : CAMERA.width].ravel()
    assert near.sum() > 40
    assert np.mean((triangle >= 0)[near] == (met >= 0)[near]) >= alike
    both = near[:, None] & (triangle >= 0) & (met >= 0)
    off_m = np.abs(1.0 / inverse[both] - exact.range_m.reshape(met.shape)[both])
    assert np.percentile(off_m, 99) < 2e-3
    edges = near & ((met >= 0).mean(axis=1) > 0.0) & ((met >= 0).mean(axis=1) < 1.0)
    share = (triangle >= 0).mean(axis=1) - (met >= 0).mean(axis=1)
    assert abs(share[edges].mean()) < 0.02


@pytest.mark.parametrize("per_px", [1, 2])
def test_a_pixel_within_a_surface_of_many_facets_shows_no_sky(per_px):
    triangles_m = np.ascontiguousarray(trimesh.creation.icosphere(subdivisions=6).triangles)  # 60 a pixel
    pose = make_pose(translation_m=(0.1, -0.05, 3.0))
    rays = RayGrid.pinhole(CAMERA, per_px).in_single_precision()
    coarse = cast(rays, triangles_m, pose, cull_back_faces=True)
    inner = np.argwhere(coarse.range_m[::per_px, ::per_px] < 2.3)  # within its limb
    surface = Surface(triangles_m, beyond_sides(triangles_m), np.eye(3), np.array(pose.translation))
    triangle, inverse = hits_of(rays.components, coarse.triangle, per_px, inner.astype(np.int32), surface)
    assert (triangle >= 0).all()
    nearest_m = 1.0 / inverse.max(axis=1)
    np.testing.assert_allclose(nearest_m, coarse.range_m[tuple(per_px * inner.T)], atol=0.05)


def test_the_triangle_beyond_a_side_is_that_with_the_opposite_edge():
    box = np.ascontiguousarray(trimesh.creation.box().triangles)
    beyond = beyond_sides(box)
    for k, side in np.ndindex(beyond.shape):
        other = box[beyond[k, side]].tolist()
        assert beyond[k, side] != k
        assert box[k, side].tolist() in other
        assert box[k, (side + 1) % 3].tolist() in other
    np.testing.assert_array_equal(beyond_sides(box[:1]), [[-1, -1, -1]])
