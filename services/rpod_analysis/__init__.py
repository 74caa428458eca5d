"""What a run came to: reading logs, scoring estimates against truth, the report."""

from rpod_analysis.errors import AnalysisError
from rpod_analysis.log import Log, Logged, TopicInfo, open_log
from rpod_analysis.run import Run, StreamedRun, read_run, stream_run
from rpod_analysis.sensors import Sensor, find_sensors, lidar_scans, pmd_frames

__all__ = [
    "AnalysisError",
    "Log",
    "Logged",
    "Run",
    "Sensor",
    "StreamedRun",
    "TopicInfo",
    "find_sensors",
    "lidar_scans",
    "open_log",
    "pmd_frames",
    "read_run",
    "stream_run",
]
