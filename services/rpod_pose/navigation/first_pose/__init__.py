"""A first pose: searches, what their results begin, and given poses."""
