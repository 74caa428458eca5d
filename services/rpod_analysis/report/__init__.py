"""The report of a run, or of several: content, figures, tables and pages."""

from rpod_analysis.report.report import (
    ReportPaths,
    group_parts,
    unique_names,
    write_comparison,
    write_report,
)

__all__ = ["ReportPaths", "group_parts", "unique_names", "write_comparison", "write_report"]
