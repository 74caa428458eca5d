"""The logger at a camera's full rate: what it loses, what it takes of a core, whether its memory grows."""
