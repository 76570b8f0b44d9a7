"""What a browser shows of a workbench."""
