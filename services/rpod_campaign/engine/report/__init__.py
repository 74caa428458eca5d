"""The parts of a report: sections, tables, figures, statistics, and the page."""
