"""HTML reports: sections, tables and style."""
