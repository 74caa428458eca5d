"""Building of a target from its parameters: surfaces, inside, samples and mass; it needs Open3D."""
