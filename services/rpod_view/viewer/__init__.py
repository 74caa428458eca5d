"""Rerun's viewer as a process of its own, and the login in front of it."""
