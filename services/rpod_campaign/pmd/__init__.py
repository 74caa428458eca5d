"""What the campaigns of the PMD camera share: scenes, worlds, methods under trial, sequences, tables."""
