"""How well tracks are predicted through gaps, on synthetic pose measurements."""
