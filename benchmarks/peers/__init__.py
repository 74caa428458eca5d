"""Peers side by side: published registration packages and our own methods on the same clouds.

Not part of the product: nothing imports it, and its packages live in a virtual environment of their own,
since OpenCV's contrib build, which has the point pair features, cannot stand beside the plain one.
``make peers`` builds that environment and prints the table.
"""
