"""Reading of logs: files, topics, sensors, counts of the services, completeness, unreadable messages."""

from rpod_analysis.log.log import Log, TopicInfo, open_log
from rpod_analysis.log.logged import Logged

__all__ = ["Log", "Logged", "TopicInfo", "open_log"]
