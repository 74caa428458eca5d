"""The control plane: queries that a service answers, queries that it asks, and who asks."""
