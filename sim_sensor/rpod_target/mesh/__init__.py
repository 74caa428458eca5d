"""Triangles of CAD files: readers, repair, simplification and topology."""
