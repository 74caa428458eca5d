"""Emulated sensors: a LIDAR and a PMD camera on one ray caster.

They are pure functions of poses, configuration and a seed; they use no bus, no clock and no logger.
"""

from rpod_schemas.caches.kernels import watch_callees

watch_callees()
