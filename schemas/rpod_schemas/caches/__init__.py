"""Caches that a host keeps between two starts: compiled kernels, the folder of built targets, whole files."""
