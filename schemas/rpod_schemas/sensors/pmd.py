"""The PMD camera: depth and amplitude of one exposure, and the methods for them."""

from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.pmd.amplitude import EpnpConfig, HybridConfig
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.config.pmd.methods import IcpReverseCalibrationConfig, SignedDistanceConfig
from rpod_schemas.config.pmd.search import PmdAcquisitionConfig
from rpod_schemas.sensors.kind import Method, Part, SensorKind
from rpod_schemas.topics import AMPLITUDE, CAMERA_INFO, DEPTH, DEPTH_SIGMA, PHASE, PMD_INFO
from rpod_schemas.types import PmdFrame, PmdInfo

PMD = SensorKind(
    name="pmd",
    title="PMD camera",
    parts={
        "depth": Part(DEPTH),
        "camera_info": Part(CAMERA_INFO, lasting=True),
        "amplitude": Part(AMPLITUDE, required=False),
    },
    info=PMD_INFO,
    frame=PmdFrame,
    info_model=PmdInfo,
    extras=(PHASE, DEPTH_SIGMA),
    emulated=PmdConfig,
    heard=PmdInput,
    reader="rpod_runtime.readers.pmd:PmdReader",
    publisher="rpod_runtime.sensors:CameraPublisher",
    emulator="rpod_emulator.pmd:PmdChannel",
    methods="rpod_pose.pmd.methods:PMD_METHODS",
    checks="rpod_driver.check.kinds:PMD_CHECKS",
    reduced_rate="rpod_runtime.sensor_data.reduced_rate:ReducedRateCamera",
)

VIEW_SEARCH = Method("pmd", "acquisition", PmdAcquisitionConfig, "rpod_pose.pmd.methods:view_search")
JOINT = Method("pmd", "tracking", JointConfig, "rpod_pose.pmd.methods:joint")
SIGNED_DISTANCE = Method("pmd", "tracking", SignedDistanceConfig, "rpod_pose.pmd.methods:signed_distance")
ICP_REVERSE_CALIBRATION = Method(
    "pmd", "tracking", IcpReverseCalibrationConfig, "rpod_pose.pmd.methods:icp_reverse_calibration"
)
EPNP = Method("pmd", "tracking", EpnpConfig, "rpod_pose.pmd.methods:epnp")
HYBRID = Method("pmd", "tracking", HybridConfig, "rpod_pose.pmd.methods:hybrid")
