"""All peers, in the order of the table. Importing this needs their packages."""

from functools import partial

from peers import open3d_features, open3d_icp, own, point_pairs, small_gicp_icp
from peers.benchmark import Peer, Scene, Task
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.types import LidarScan

_TEMPLATES = {
    "acquisition": {"kind": "template_matching", "step_deg": 30.0},
    "tracking": {"kind": "icp_nearest_neighbour"},
}
_OPEN3D, _OPENCV, _SMALL_GICP, _OWN = "open3d", "opencv-contrib-python-headless", "small_gicp", "rpod"
_DEFAULT = LidarInput()

PEERS: tuple[Peer[Scene, LidarScan], ...] = (
    Peer("FPFH + RANSAC", _OPEN3D, Task.ACQUISITION, open3d_features.RANSAC_SETUP, open3d_features.ransac),
    Peer("FPFH + FGR", _OPEN3D, Task.ACQUISITION, open3d_features.FGR_SETUP, open3d_features.fast_global),
    Peer("PPF", _OPENCV, Task.ACQUISITION, point_pairs.SETUP, point_pairs.point_pairs),
    Peer("ICP from the centroid", _OWN, Task.ACQUISITION, "attitude of the sensor", own.from_centroid),
    Peer(
        "template matching, 30 deg",
        _OWN,
        Task.ACQUISITION,
        "the one that explains most of 10 templates",
        partial(own.acquisition, _TEMPLATES),
    ),
    Peer(
        "the facility's default",
        _OWN,
        Task.ACQUISITION,
        _DEFAULT.acquisition.kind,
        partial(own.acquisition, {}),
    ),
    Peer("ICP point to point", _OPEN3D, Task.TRACKING, open3d_icp.POINT_SETUP, open3d_icp.point_to_point),
    Peer("ICP point to plane", _OPEN3D, Task.TRACKING, open3d_icp.PLANE_SETUP, open3d_icp.point_to_plane),
    Peer("ICP", _SMALL_GICP, Task.TRACKING, small_gicp_icp.SETUP, small_gicp_icp.icp),
    Peer("plane ICP", _SMALL_GICP, Task.TRACKING, small_gicp_icp.SETUP, small_gicp_icp.plane_icp),
    Peer("GICP", _SMALL_GICP, Task.TRACKING, small_gicp_icp.SETUP, small_gicp_icp.gicp),
    Peer("VGICP", _SMALL_GICP, Task.TRACKING, small_gicp_icp.VGICP_SETUP, small_gicp_icp.vgicp),
    Peer("nearest-neighbour ICP", _OWN, Task.TRACKING, "gate 0.3 m and more", own.finish),
    Peer("the facility's default", _OWN, Task.TRACKING, _DEFAULT.tracking.kind, partial(own.tracking, {})),
)
