"""``rpod pki``: certificates and access rules."""
