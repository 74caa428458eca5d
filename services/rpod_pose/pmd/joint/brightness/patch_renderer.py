"""The target rendered on the pixels of an image, as bright as its file says and as the image says."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_geometry.finer_rays import Surface
from rpod_geometry.kernels import kernel
from rpod_geometry.rays import GridArrays, RenderBuffers
from rpod_pose.pmd.joint.brightness.amplitude_noise import sky_of
from rpod_pose.pmd.joint.brightness.brightness_fit import (
    faintest,
    fitted,
    followed,
    misfit,
    predicted,
    rendered_by_file,
)
from rpod_pose.pmd.joint.brightness.mixture import Mixture, Shape, mixture_of
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_pose.pmd.rendering import Window
from rpod_pose.registration.brightness import albedos, faces_of, surfaces_of
from rpod_pose.registration.lie_group import PoseArrays, in_target
from rpod_pose.registration.surface_model import Faces, cast_faces
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.joint import JointEdgeConfig
from rpod_schemas.types import Float32Array
from rpod_target import Target
from rpod_target.mesh.topology import beyond_sides

NO_GAIN = np.empty(0, np.float32)


class Appearance(NamedTuple):
    """Shape and albedo of the target for its rendering."""

    triangles_m: FloatArray
    """Corners, target axes, shape (T, 3, 3)."""
    normals: FloatArray
    """Outward unit normals, target axes, shape (T, 3)."""
    albedo: FloatArray
    """Median albedo of each triangle's class, shape (T,)."""
    radius_m: float
    """Radius of the bounding sphere about the origin."""

    @classmethod
    def of(cls, target: Target) -> "Appearance":
        """Return the appearance of a target."""
        triangles_m, normals = (np.ascontiguousarray(part) for part in (target.triangles_m, target.normals))
        return cls(triangles_m, normals, albedos(target), target.radius_m)


class Shown(NamedTuple):
    """A rendering of the target at a pose on the pixels of the patch."""

    pose: PoseArrays
    range_m: Float32Array
    """Range along each ray, shape (per_px * rows, per_px * columns); inf if it hits nothing."""
    per_px: int
    """Number of rays for each pixel, along rows and columns."""
    window: Window
    """The pixels around the target."""
    shade: Float32Array
    """Smoothed brightness with the materials of the file, on the pixels of the window."""
    typical: float
    """Median brightness before smoothing; 0 if nothing is in view."""
    fitted: Float32Array
    """Smoothed brightness, with that of each surface fitted to the image and in its units; same pixels."""


class Rendered(NamedTuple):
    """A rendering, and what its brightness consists of."""

    shown: Shown
    mixture: Mixture
    """The surfaces that the pixels of the window show."""
    gain: Float32Array
    """Fitted factor on the brightness of each surface, shape (K,); shape (0,) if nothing is in view."""
    behind: Float32Array | float
    """Smoothed brightness of the thing behind the target, in units of the image; 0 if it is dark."""


class PatchRenderer:
    """Renders the target on the pixels of a patch.

    Args:
        target: the target.
        config: how the image is clipped and smoothed, which applies to the rendering too.
    """

    def __init__(self, target: Target, config: JointEdgeConfig) -> None:
        self._appearance, self._config = Appearance.of(target), config
        self._faces, self._surfaces = faces_of(target), surfaces_of(target)
        self._triangles = Faces.of(target)
        self._beyond = beyond_sides(np.asarray(target.triangles_m))
        self._room = np.empty((2, 0), np.float32)

    @property
    def radius_m(self) -> float:
        """Radius of the target's bounding sphere about its origin."""
        return self._appearance.radius_m

    @property
    def faces(self) -> Faces:
        """The target's triangles, for casting rays."""
        return self._triangles

    @property
    def blur_px(self) -> float:
        """Standard deviation of the blur of images, px."""
        return self._config.blur_px

    def cast(self, rays: GridArrays, pose: PoseArrays) -> RenderBuffers:
        """Return the first hits of a patch's rays at a pose; the next call overwrites them."""
        rows, columns = rays.components.shape[1:]
        if self._room.shape[1] < rows * columns:
            self._room = np.empty((2, rows * columns), np.float32)
        range_m, triangle = (line[: rows * columns].reshape(rows, columns) for line in self._room)
        hits = RenderBuffers(range_m, triangle.view(np.int32))
        cast_faces(rays, self._triangles, pose.R, pose.t, hits)
        return hits

    def render(self, rays: GridArrays, per_px: int, pose: PoseArrays, patch: Patch) -> Rendered:
        """Return a rendering of the target at a pose.

        Args:
            rays: rays of the patch's pixels, shape (per_px * rows, per_px * columns).
            per_px: number of rays for each pixel, along rows and columns.
            pose: pose of the target.
            patch: the image.
        """
        hits, clip, blur_px = self.cast(rays, pose), self._config.clip, self._config.blur_px
        mixture = mixture_of(rays.components, hits, per_px, self._shape(pose, self._surfaces, patch))
        shade, typical = rendered_by_file(mixture, clip=clip, blur_px=blur_px)
        fit, gain, behind = shade, NO_GAIN, None
        if typical > 0.0 and patch.typical > 0.0:
            fit, gain = fitted(patch, mixture, typical, clip=clip, blur_px=blur_px)
            behind = brightness_behind(patch, mixture, blur_px)
        if behind is not None:
            shade, fit = shade + behind * np.float32(typical / patch.typical), fit + behind
        shown = Shown(pose, hits.range_m.copy(), per_px, mixture.window, shade, typical, fit)
        return Rendered(shown, mixture, gain, 0.0 if behind is None else behind)

    def followed(self, rendered: Rendered, patch: Patch) -> Shown:
        """Return a rendering whose brightness also follows the image within each surface.

        Args:
            rendered: the rendering.
            patch: the image that it was fitted to.
        """
        shown, mixture, gain, behind = rendered
        if not gain.size:
            return shown
        fit = followed(patch, mixture, gain, clip=self._config.clip, blur_px=self._config.blur_px)
        return shown._replace(fitted=fit + behind)

    def misfit(self, rays: GridArrays, per_px: int, pose: PoseArrays, patch: Patch) -> float:
        """Return minus the log likelihood of a patch at a pose, with the brightness of each face fitted.

        Arguments as for ``render``.
        """
        mixture = self._faces_at(rays, per_px, pose, patch)
        return misfit(patch, mixture, clip=self._config.clip, blur_px=self._config.blur_px)

    def predicted(self, rays: GridArrays, per_px: int, pose: PoseArrays, patch: Patch) -> Float32Array:
        """Return the image of the patch's pixels at a pose, with the brightness of each face fitted.

        Arguments as for ``render``.
        """
        mixture = self._faces_at(rays, per_px, pose, patch)
        shown = predicted(patch, mixture, clip=self._config.clip, blur_px=self._config.blur_px)
        image, (row, column, rows, columns) = np.full_like(patch.image, shown.sky), mixture.window
        image[row : row + rows, column : column + columns] = shown.image
        return image

    def _faces_at(self, rays: GridArrays, per_px: int, pose: PoseArrays, patch: Patch) -> Mixture:
        """Return the faces that the pixels of a patch show at a pose; arguments as for ``render``."""
        hits = self.cast(rays, pose)
        return mixture_of(rays.components, hits, per_px, self._shape(pose, self._faces, patch))

    def _shape(self, pose: PoseArrays, part: NDArray[np.int32], patch: Patch) -> Shape:
        surface = Surface(self._appearance.triangles_m, self._beyond, pose.R, pose.t)
        return Shape(surface, part, light_of(self._appearance, pose), patch.rad_per_m)


def brightness_behind(patch: Patch, mixture: Mixture, blur_px: float) -> Float32Array | None:
    """Return the brightness that the thing behind the target adds to the pixels of the window, smoothed.

    None where it is as dark as differences that are no change of the image.
    """
    sky = sky_of(patch, mixture.free, mixture.window)
    if not sky > faintest(patch):
        return None
    behind = np.float32(sky) * mixture.free
    cv2.GaussianBlur(behind, (0, 0), blur_px, dst=behind)
    return behind


@kernel
def light_of(appearance: Appearance, pose: PoseArrays) -> Float32Array:
    """Return the brightness of each triangle at a pose, times the cubed range of a ray, shape (T,), m.

    By Lambert's law with light from the camera, the brightness is albedo times cosine of incidence over
    squared range. The cosine is the distance of the triangle's plane from the camera over the range.

    Args:
        appearance: T triangles.
        pose: pose of the target.
    """
    light = np.empty(len(appearance.albedo), np.float32)
    sx, sy, sz = in_target(pose.R, -pose.t[0], -pose.t[1], -pose.t[2])
    for k in range(len(appearance.albedo)):
        corner, normal = appearance.triangles_m[k, 0], appearance.normals[k]
        x, y, z = sx - corner[0], sy - corner[1], sz - corner[2]
        light[k] = appearance.albedo[k] * abs(normal[0] * x + normal[1] * y + normal[2] * z)
    return light
