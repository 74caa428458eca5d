"""A readable log out of a truncated or damaged one."""

from rpod_analysis.recovery.recover import recover, recovered_path

__all__ = ["recover", "recovered_path"]
