"""What the directions of all effects say at a fitted model: is anything missing, and what is worth a fit."""
