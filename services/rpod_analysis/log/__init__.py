"""Reading logs: files, topics, sensors, the services' counts, completeness, messages that cannot be read."""

from rpod_analysis.log.log import Log, Logged, TopicInfo, is_latched, open_log

__all__ = ["Log", "Logged", "TopicInfo", "is_latched", "open_log"]
