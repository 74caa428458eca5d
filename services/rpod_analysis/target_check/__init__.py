"""Check of a target: size, symmetries, mass, edges, accuracy, methods; and a page of it."""

from rpod_analysis.target_check.check import TargetCheck, check_target
from rpod_analysis.target_check.likeness import checked_symmetries
from rpod_analysis.target_check.page import write_page

__all__ = ["TargetCheck", "check_target", "checked_symmetries", "write_page"]
