"""What a notebook shows: equations and tables, and the live part of the report as a widget."""
