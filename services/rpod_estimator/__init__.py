"""Finds and tracks the target's pose in the sensors' data; never reads truth."""

from rpod_schemas.kernel_cache import watch_callees

watch_callees()
