"""Lenses, rays and their hits on a target, for the emulated sensors and for the pose estimation."""

from rpod_schemas.caches.kernels import watch_callees

watch_callees()
