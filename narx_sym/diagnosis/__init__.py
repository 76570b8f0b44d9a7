"""Which physical effect a model lacks."""
