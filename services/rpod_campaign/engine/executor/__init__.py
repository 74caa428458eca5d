"""Executors of trials: this machine's cores, or the workers of a cluster, behind one port."""

from rpod_campaign.engine.executor.port import Executor, Finished, Task, Work

__all__ = ["Executor", "Finished", "Task", "Work"]
