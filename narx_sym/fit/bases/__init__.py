"""Bases: the selection of terms, and models that remember where the input turned."""
