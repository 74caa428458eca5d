"""Trajectories of the chaser: approaches, orbits, and turns with the target."""
