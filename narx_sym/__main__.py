"""`python -m narx_sym` is the `narx-sym` command."""

from .cli import main

main()
