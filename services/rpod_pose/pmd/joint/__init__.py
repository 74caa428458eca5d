"""The joint tracker: a least-squares fit of depth points and of edges in the amplitude image together."""
