"""Laws in numbers: where they start, whether they ring, what they do over a reference."""
