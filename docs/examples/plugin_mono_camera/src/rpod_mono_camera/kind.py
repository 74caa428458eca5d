"""The camera as rpod knows it: everything heavy is named, and imported by the process that needs it."""

from rpod_mono_camera.config import EdgeTrackingConfig, MonoConfig, MonoInput, NearPredictionConfig
from rpod_mono_camera.frame import MonoFrame
from rpod_schemas.sensors import Method, Part, SensorKind
from rpod_schemas.topics import CAMERA_INFO, Topic

IMAGE = Topic("<camera>/image_raw", "sensor_msgs/msg/Image")

MONO = SensorKind(
    name="mono",
    title="monocular camera",
    parts={"image": Part(IMAGE), "camera_info": Part(CAMERA_INFO, lasting=True)},
    frame=MonoFrame,
    emulated=MonoConfig,
    heard=MonoInput,
    reader="rpod_mono_camera.bus:MonoReader",
    publisher="rpod_mono_camera.bus:MonoPublisher",
    emulator="rpod_mono_camera.channel:MonoChannel",
    methods="rpod_mono_camera.methods:MONO_METHODS",
)

EDGES = Method("mono", "tracking", EdgeTrackingConfig, "rpod_mono_camera.methods:edges")
NEAR_PREDICTION = Method(
    "mono", "acquisition", NearPredictionConfig, "rpod_mono_camera.methods:near_prediction"
)
