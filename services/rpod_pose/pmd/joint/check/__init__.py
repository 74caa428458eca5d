"""Whether a frame agrees with a pose: its pixels and edges, and the belief that follows."""
