"""The interfaces of the facility: topics, messages and their checks, configuration.

The interface control document, ``schemas/ICD.md``, in code. This package imports no bus and no
clock; everything above it imports this package.
"""
