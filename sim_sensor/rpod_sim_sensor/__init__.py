"""Emulated sensors: a LIDAR and a PMD camera on one ray caster.

Pure functions of poses, configuration and a seed: no bus, no clock, no logger.
"""

from rpod_schemas.kernel_cache import watch_callees

watch_callees()
