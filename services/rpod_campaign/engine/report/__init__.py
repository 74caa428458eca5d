"""What a report is made of: sections, tables, figures, statistics, and the page."""
