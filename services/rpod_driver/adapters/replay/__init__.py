"""A recording as a sensor: rosbag2, MCAP, or a folder of PNG images."""

from rpod_driver.adapters.replay.config import ReplayConfig
from rpod_driver.registered import Adapter

REPLAY = Adapter(
    name="replay",
    title="A recording: rosbag2, MCAP, or a folder of PNG images",
    config=ReplayConfig,
    build="rpod_driver.adapters.replay.driver:open_driver",
    tested="on recordings of each form",
    needs="pip install 'rpod[estimator]'",
)
