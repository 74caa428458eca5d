"""``rpod campaign``: its verbs, its output, and the progress of its trials."""
