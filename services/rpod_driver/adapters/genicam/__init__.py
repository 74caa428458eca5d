"""3D cameras of the GenICam standard through ``harvesters``, by the producer (.cti) of the camera's maker."""

from rpod_driver.adapters.genicam.config import GenicamConfig
from rpod_driver.registered import Adapter

GENICAM = Adapter(
    name="genicam",
    title="3D camera of the GenICam standard (Scan3d), by its maker's GenTL producer",
    config=GenicamConfig,
    build="rpod_driver.adapters.genicam.driver:open_driver",
    tested="with the simulated camera of genicam's own producer (viky.cti); without a device",
    needs="pip install 'rpod[genicam]', and the GenTL producer of the camera's maker",
)
