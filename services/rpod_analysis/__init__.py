"""Analysis of runs: reads logs, compares estimates with the truth, writes reports."""

from rpod_analysis.errors import AnalysisError
from rpod_analysis.log import Log, Logged, TopicInfo, open_log
from rpod_analysis.log.sensors import Sensor, find_sensors, lidar_scans, pmd_frames
from rpod_analysis.scoring.run import Run, StreamedRun, read_run, stream_run

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
