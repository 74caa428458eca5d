"""NEES of logged estimates beside a truth with errors, over seeds of these errors."""
