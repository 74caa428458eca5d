"""Lenses, rays and their hits on a target, for the emulated sensors and for the pose estimation."""

from rpod_schemas.kernel_cache import watch_callees

watch_callees()
