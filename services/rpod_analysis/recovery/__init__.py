"""Recovery of a readable log from a truncated or damaged one."""

from rpod_analysis.recovery.recover import recover

__all__ = ["recover"]
