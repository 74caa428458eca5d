"""Rays, lenses and their hits on a target: shared by the emulated sensors and the pose estimation."""

from rpod_schemas.kernel_cache import watch_callees

watch_callees()
