"""Where trials run: on this machine's cores, or on the workers of a cluster, behind one port."""

from rpod_campaign.engine.executor.port import Executor, Finished, Task, Work

__all__ = ["Executor", "Finished", "Task", "Work"]
