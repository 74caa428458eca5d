"""3D heads of an ifm O3R, live through ``ifm3dpy``, or from recorded PCIC buffers."""

from rpod_driver.adapters.ifm.config import IfmConfig
from rpod_driver.registered import Adapter

IFM = Adapter(
    name="ifm",
    title="3D head of an ifm O3R (PMD camera), live or a recorded buffer",
    config=IfmConfig,
    build="rpod_driver.adapters.ifm.driver:open_driver",
    tested="on a recorded buffer; live without a device",
    needs="pip install 'rpod[ifm]' for a live device",
)
