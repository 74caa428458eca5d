"""The scanning LIDAR: one point cloud a scan, and the methods for it."""

from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar.methods import IcpNearestNeighbourConfig, TemplateMatchingConfig
from rpod_schemas.config.lidar.search import GlobalSearchConfig, ProjectiveIcpConfig
from rpod_schemas.sensors.kind import Method, Part, SensorKind
from rpod_schemas.topics import LIDAR_INFO, POINTS
from rpod_schemas.types import LidarInfo, LidarScan

LIDAR = SensorKind(
    name="lidar",
    title="LIDAR",
    parts={"points": Part(POINTS)},
    info=LIDAR_INFO,
    frame=LidarScan,
    info_model=LidarInfo,
    emulated=LidarConfig,
    heard=LidarInput,
    reader="rpod_runtime.readers.lidar:LidarReader",
    publisher="rpod_runtime.sensors:LidarPublisher",
    emulator="rpod_emulator.lidar:LidarChannel",
    methods="rpod_pose.lidar.methods:LIDAR_METHODS",
    checks="rpod_driver.check.kinds:LIDAR_CHECKS",
)

GLOBAL = Method("lidar", "acquisition", GlobalSearchConfig, "rpod_pose.lidar.methods:global_search")
TEMPLATE_MATCHING = Method(
    "lidar", "acquisition", TemplateMatchingConfig, "rpod_pose.lidar.methods:template_matching"
)
PROJECTIVE_POINT_TO_PLANE = Method(
    "lidar", "tracking", ProjectiveIcpConfig, "rpod_pose.lidar.methods:projective_point_to_plane"
)
ICP_NEAREST_NEIGHBOUR = Method(
    "lidar", "tracking", IcpNearestNeighbourConfig, "rpod_pose.lidar.methods:icp_nearest_neighbour"
)
