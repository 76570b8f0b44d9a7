"""Where a model rests, and whether it stays there."""
