"""The peers in a camera's frames, in the order of the table. Importing this needs their packages."""

from functools import partial

from scipy.spatial.transform import RigidTransform

from peers import open3d_icp, small_gicp_icp
from peers.benchmark import Peer, Register, Task
from peers.camera import CameraScene, CameraView
from peers.clouds import model_cloud
from peers.open3d_icp import Estimation
from peers.small_gicp_icp import Setup
from rpod_campaign.pmd.methods import DEFAULT, PAPER_ICP, pmd_input
from rpod_pose.methods import ready_methods

POINT_SPACING_M, PLANE_SPACING_M = 0.02, 0.02
"""Spacing of the model's points for Open3D; the best of 0.02, 0.03 and 0.05."""
POINT_DISTANCE_M, PLANE_DISTANCE_M = 0.5, 0.5
"""Largest distance of a pair for Open3D; the best of 0.2, 0.3, 0.5 and 1."""
SMALL_GICP = Setup(spacing_m=0.02, distance_m=0.5, voxel_m=0.1)
"""The best of spacings of 0.02 and 0.03, distances of 0.2, 0.3, 0.5 and 1, and voxels of 0.03, 0.05,
0.08, 0.1 and 0.2, m."""

_OPEN3D_SETUP = open3d_icp.SETUP
_SMALL_GICP_SETUP = (
    f"the whole model once, a point every {SMALL_GICP.spacing_m:g} m, pairs to {SMALL_GICP.distance_m:g} m, "
    f"voxels of {SMALL_GICP.voxel_m:g} m (tuned)"
)


def _open3d(
    scene: CameraScene, *, spacing_m: float, distance_m: float, estimation: Estimation
) -> Register[CameraView]:
    return open3d_icp.icp(model_cloud(scene.target, spacing_m), distance_m, estimation)


def _small_gicp(scene: CameraScene, *, kind: str) -> Register[CameraView]:
    if kind == "VGICP":
        return small_gicp_icp.by_voxels(scene.target, SMALL_GICP)
    return small_gicp_icp.by_points(scene.target, kind, SMALL_GICP)


def _own(scene: CameraScene, *, method: str) -> Register[CameraView]:
    methods = ready_methods(pmd_input(method), scene.target)

    def register(view: CameraView, start: RigidTransform) -> RigidTransform | None:
        return methods.tracker.track(view.frame, start).T_sensor_target

    return register


def _searching(scene: CameraScene) -> Register[CameraView]:
    methods = ready_methods(pmd_input(DEFAULT), scene.target)

    def register(view: CameraView, start: RigidTransform) -> RigidTransform | None:
        return methods.acquirer.near(view.frame, start).pose

    return register


CAMERA_PEERS: tuple[Peer[CameraScene, CameraView], ...] = (
    Peer(
        "the 2018 paper's ICP",
        "rpod",
        Task.TRACKING,
        "reverse calibration, point to point, radius 25 px",
        partial(_own, method=PAPER_ICP),
    ),
    Peer(
        "ICP point to point",
        "open3d",
        Task.TRACKING,
        _OPEN3D_SETUP.format(POINT_SPACING_M, POINT_DISTANCE_M),
        partial(
            _open3d, spacing_m=POINT_SPACING_M, distance_m=POINT_DISTANCE_M, estimation=open3d_icp.POINTS
        ),
    ),
    Peer(
        "ICP point to plane",
        "open3d",
        Task.TRACKING,
        _OPEN3D_SETUP.format(PLANE_SPACING_M, PLANE_DISTANCE_M),
        partial(
            _open3d, spacing_m=PLANE_SPACING_M, distance_m=PLANE_DISTANCE_M, estimation=open3d_icp.PLANES
        ),
    ),
    *(
        Peer(name, "small_gicp", Task.TRACKING, _SMALL_GICP_SETUP, partial(_small_gicp, kind=kind))
        for name, kind in (("ICP", "ICP"), ("plane ICP", "PLANE_ICP"), ("GICP", "GICP"), ("VGICP", "VGICP"))
    ),
    *(
        Peer(name, "rpod", Task.TRACKING, pmd_input(method).tracking.kind, partial(_own, method=method))
        for name, method in (
            ("reverse calibration, to planes", "icp-reverse-calibration-plane"),
            ("signed distance", "signed-distance"),
            ("the facility's default", DEFAULT),
        )
    ),
    Peer(
        "the default, searching around",
        "rpod",
        Task.TRACKING,
        "what the navigator does where a prediction is vague",
        _searching,
    ),
)
