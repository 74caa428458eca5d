"""What messages of sensors need before they are frames: codecs, mounts, rays, stamps, reduced rates."""
