"""The joint tracker: distances of depth points and places of amplitude edges in one least squares."""
