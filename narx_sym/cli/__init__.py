"""The `narx-sym` command."""
