"""The joint tracker: distances of depth points and positions of amplitude edges in one least squares."""
