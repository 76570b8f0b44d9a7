"""Bases that remember where the input turned, and the choice among all bases."""
