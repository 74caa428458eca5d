"""The scene in Rerun's terms: images with the wireframe over them, points, meshes, ellipsoids."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.errors import DistortionError
from rpod_geometry.rays import RayGrid
from rpod_geometry.wireframe import project, visible_pieces
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera, FrameImage, Integrity, Odometry
from rpod_target import Target
from rpod_view import palette
from rpod_view.layout import CHASER, ESTIMATE, FOCUS, IMAGES, TIMELINE, TRUTH, UNCERTAINTY
from rpod_view.scene import Frame
from rpod_view.shading import MILLIMETRES, depth_colours, depth_mm, depth_span_m, ellipsoid, grey

_ELLIPSOID = f"{CHASER}/uncertainty"
_LEVEL = f"{CHASER}/level"
_MOST_POINTS = 20_000
_FEW_POINTS = 5_000
"""Largest number of points at which each is drawn larger."""
_VANISHING = 1e-6
"""Scale of hidden objects, because Rerun cannot clear static data."""
_LINE = rr.Radius.ui_points(1.0)
_POINT, _LARGE_POINT, _LARGEST_POINT = (rr.Radius.ui_points(size) for size in (1.2, 2.2, 5.0))


class Drawing:
    """Draws frames and poses into a recording.

    Args:
        recording: the recording to draw into.
        target: the target whose mesh and wireframe are drawn; None if it is not known.
    """

    def __init__(self, recording: rr.RecordingStream, target: Target | None) -> None:
        self._recording, self._target = recording, target
        self._knows_focus = False
        self._rays: dict[str, tuple[Camera, FloatArray | None]] = {}
        recording.log(CHASER, rr.TransformAxes3D(axis_length=0.3), static=True)
        recording.log(UNCERTAINTY, rr.TransformAxes3D(axis_length=0.25), static=True)
        if target is not None:
            self._draw_target(target)

    def _draw_target(self, target: Target) -> None:
        albedo = np.array([material.diffuse for material in target.materials])[target.triangle_material]
        tones = np.repeat(np.interp(albedo, (0.0, 1.0), (70.0, 215.0)).astype(np.uint8), 3)
        truth = rr.Mesh3D(
            vertex_positions=target.triangles_m.reshape(-1, 3),
            vertex_normals=np.repeat(target.normals, 3, axis=0),
            vertex_colors=np.column_stack([tones, tones, tones]),
        )
        estimate = rr.Mesh3D(
            vertex_positions=target.triangles_m.reshape(-1, 3),
            vertex_normals=np.repeat(target.normals, 3, axis=0),
            albedo_factor=(*palette.ESTIMATE, 36),
        )
        lines = rr.LineStrips3D(target.edges_m.astype(np.float32), colors=palette.ESTIMATE, radii=_LINE)
        self._recording.log(f"{TRUTH}/mesh", truth, static=True)
        self._recording.log(f"{ESTIMATE}/mesh", estimate, static=True)
        self._recording.log(f"{ESTIMATE}/wireframe", lines, static=True)

    # --- frames ---

    def frame(self, frame: Frame, T_chaser_target: RigidTransform | None) -> None:
        """Draw a frame at its stamp; over its images draw the wireframe at the estimate of that time."""
        self._at(frame.data.stamp_ns)
        if frame.T_chaser_sensor is not None:
            self._place(f"{CHASER}/{frame.sensor}", frame.T_chaser_sensor)
        if frame.data.lens is not None:
            self._images(frame, frame.data.lens, T_chaser_target)
        if len(returns_m := frame.data.returns_m):
            self._cloud(frame, returns_m, depth_span_m(returns_m[:, 2]))

    def _images(self, frame: Frame, camera: Camera, T_chaser_target: RigidTransform | None) -> None:
        outline = self._outline(frame, camera, T_chaser_target).astype(np.float32)
        lines = rr.LineStrips2D(outline, colors=palette.ESTIMATE, radii=_LINE)
        rays = self._rays_of(frame.sensor, camera)
        for image in frame.data.images:
            path = f"{IMAGES}/{frame.sensor}/{image.title}"
            if image.scale == "depth":
                self._recording.log(path, self._depth(frame, image, rays))
            else:
                self._recording.log(path, rr.Image(grey(image.values)))
            self._recording.log(f"{path}/wireframe", lines)

    def _depth(self, frame: Frame, image: FrameImage, rays: FloatArray | None) -> rr.DepthImage:
        """Return a depth image; also draw its points if the rays of the lens are known."""
        span_m = depth_span_m(image.values)
        if rays is not None:
            seen = np.isfinite(image.values)
            self._cloud(frame, rays[seen] * image.values[seen][:, None], span_m)
        return rr.DepthImage(
            depth_mm(image.values, span_m),
            meter=MILLIMETRES,
            colormap="viridis",
            depth_range=(MILLIMETRES * span_m[1], MILLIMETRES * span_m[0]),
        )

    def _outline(
        self, frame: Frame, camera: Camera, T_chaser_target: RigidTransform | None
    ) -> NDArray[np.float64]:
        if self._target is None or frame.T_chaser_sensor is None or T_chaser_target is None:
            return np.zeros((0, 2, 2))
        return project(visible_pieces(self._target, frame.T_chaser_sensor.inv() * T_chaser_target), camera)

    def _rays_of(self, sensor: str, camera: Camera) -> FloatArray | None:
        """Return a camera's rays of unit depth, shape (height, width, 3); None if its lens has no inverse."""
        known, rays = self._rays.get(sensor, (None, None))
        if known is None or not _same(known, camera):
            rays = _unit_depth(camera)
            self._rays[sensor] = camera, rays
            self._recording.log(
                f"{CHASER}/{sensor}/camera",
                rr.Pinhole(
                    image_from_camera=camera.K,
                    resolution=(camera.width, camera.height),
                    image_plane_distance=0.6,
                    color=palette.QUIET,
                ),
                static=True,
            )
        return rays

    def _cloud(self, frame: Frame, points_m: NDArray[np.floating], span_m: tuple[float, float]) -> None:
        points_m = points_m[:: len(points_m) // _MOST_POINTS + 1]
        colours = depth_colours(points_m[:, 2], span_m)
        size = _POINT if len(points_m) > _FEW_POINTS else _LARGE_POINT
        cloud = rr.Points3D(points_m.astype(np.float32), colors=colours, radii=size)
        self._recording.log(f"{CHASER}/{frame.sensor}/points", cloud)
        if not self._knows_focus and frame.T_chaser_sensor is not None and len(points_m):
            self._focus(frame.T_chaser_sensor.apply(np.median(points_m, axis=0)))

    # --- poses ---

    def poses(
        self,
        stamp_ns: int,
        truth: RigidTransform | None,
        estimate: RigidTransform | None,
        newest: Odometry | None,
    ) -> None:
        """Draw the target at the truth and at the estimate; hide it where the pose is not known.

        Args:
            stamp_ns: stamp of the poses.
            truth: true T_chaser_target.
            estimate: estimated T_chaser_target.
            newest: the estimate whose covariance is drawn.
        """
        self._at(stamp_ns)
        self._show(TRUTH, truth)
        self._show(ESTIMATE, estimate)
        known = estimate if truth is None else truth
        if known is not None:
            self._knows_focus = True
            self._focus(known.translation)
        if estimate is None or newest is None:
            for path in (_ELLIPSOID, *(f"{UNCERTAINTY}/{name}" for name in ("ellipsoid", "end", "truth"))):
                self._recording.log(path, rr.Clear(recursive=False))
        else:
            self._uncertainty(truth, estimate, newest.pose_covariance[:3, :3])

    def level(self, estimate: RigidTransform | None, integrity: Integrity | None) -> None:
        """Draw the position's protection level around the estimate, coloured by the integrity's state.

        It is a sphere about the target's origin, at the stamp of the poses.
        """
        if estimate is None or integrity is None or not np.isfinite(integrity.position_level_m):
            self._recording.log(_LEVEL, rr.Clear(recursive=False))
            return
        sphere = rr.Ellipsoids3D(
            half_sizes=[[integrity.position_level_m] * 3],
            centers=[estimate.translation],
            colors=palette.INTEGRITY[integrity.state],
            line_radii=_LINE,
            fill_mode="majorwireframe",
        )
        self._recording.log(_LEVEL, sphere)

    def _uncertainty(
        self, truth: RigidTransform | None, estimate: RigidTransform, covariance_m2: FloatArray
    ) -> None:
        """Draw the ellipsoid at its place, and enlarged to a longest half axis of 1, there with the truth."""
        half_m, quaternion = ellipsoid(covariance_m2)
        longest_m = max(float(half_m[-1]), 1e-6)
        end = rr.Points3D(
            Rotation.from_quat(quaternion).apply([0.0, 0.0, 1.0]),
            labels=f"{MILLIMETRES * longest_m:.0f} mm",
            colors=palette.ELLIPSOID,
            radii=_POINT,
        )
        large = _ellipsoid(half_m / longest_m, quaternion, np.zeros(3))
        self._recording.log(_ELLIPSOID, _ellipsoid(half_m, quaternion, estimate.translation))
        self._recording.log(f"{UNCERTAINTY}/ellipsoid", large)
        self._recording.log(f"{UNCERTAINTY}/end", end)
        if truth is None:
            self._recording.log(f"{UNCERTAINTY}/truth", rr.Clear(recursive=False))
        else:
            error = (truth.translation - estimate.translation) / longest_m
            point = rr.Points3D([error], colors=palette.TRUTH, radii=_LARGEST_POINT)
            self._recording.log(f"{UNCERTAINTY}/truth", point)

    def _focus(self, position_m: FloatArray) -> None:
        self._recording.log(FOCUS, rr.Transform3D(translation=position_m))

    def _show(self, path: str, pose: RigidTransform | None) -> None:
        if pose is None:
            self._recording.log(path, rr.Transform3D(scale=_VANISHING))
        else:
            self._place(path, pose)

    def _place(self, path: str, pose: RigidTransform) -> None:
        quaternion = rr.Quaternion(xyzw=pose.rotation.as_quat())
        self._recording.log(path, rr.Transform3D(translation=pose.translation, quaternion=quaternion))

    def _at(self, stamp_ns: int) -> None:
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))


def _ellipsoid(half: FloatArray, quaternion: FloatArray, centre: FloatArray) -> rr.Ellipsoids3D:
    return rr.Ellipsoids3D(
        half_sizes=[half],
        quaternions=[rr.Quaternion(xyzw=quaternion)],
        centers=[centre],
        colors=palette.ELLIPSOID,
        line_radii=_LINE,
        fill_mode="majorwireframe",
    )


def _unit_depth(camera: Camera) -> FloatArray | None:
    try:
        directions = RayGrid.pinhole(camera).directions
    except DistortionError:
        return None
    return np.asarray(directions / directions[..., 2:])


def _same(first: Camera, second: Camera) -> bool:
    return first is second or first.model_dump_json() == second.model_dump_json()
