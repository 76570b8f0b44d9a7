"""What people ask for: one function for each, which command line, page and report share. Nothing here prints."""
