"""Reading of logs: files, topics, sensors, counts of the services, completeness, unreadable messages."""

from rpod_analysis.log.log import Log, Logged, TopicInfo, open_log

__all__ = ["Log", "Logged", "TopicInfo", "open_log"]
