"""What messages of sensors need before they are frames: codecs, mounts, rays, stamps, a thinned stream."""
