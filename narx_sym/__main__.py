"""`python -m narx_sym` is the `narx-sym` command."""

import sys

from .errors import INTERRUPTED


def main() -> None:
    """Run the command; Ctrl-C gives one line, while modules are loaded too."""
    try:
        from .cli.main import main as run

        run()
    except KeyboardInterrupt:
        print(INTERRUPTED, file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
