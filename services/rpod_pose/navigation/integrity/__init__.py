"""Integrity: bounds of the error that an estimate may have without an alert, and the tests for an alert."""
