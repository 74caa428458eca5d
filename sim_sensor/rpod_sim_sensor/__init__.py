"""What a sensor sees: one ray caster, and on it a flash LIDAR and a PMD camera.

Pure functions of poses, configuration and a seed: no bus, no clock, no logger.
"""

from rpod_schemas.kernel_cache import watch_callees

watch_callees()
