"""How reading a log scales with its length."""
