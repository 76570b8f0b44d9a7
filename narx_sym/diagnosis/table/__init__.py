"""The one table of hypotheses: what is compared, how it is fitted, and what the verdict reads."""
