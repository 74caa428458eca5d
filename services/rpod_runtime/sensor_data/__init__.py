"""From messages of sensors to frames: codecs, mounts, rays, stamps, reduced rates."""
