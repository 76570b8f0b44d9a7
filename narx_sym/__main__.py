"""`python -m narx_sym` is the `narx-sym` command."""

import sys

from .cli import stop
from .errors import INTERRUPTED


def main() -> None:
    """Run the command; Ctrl-C gives one line, while modules are loaded too."""
    stop.arm()
    try:
        from .cli.main import main as run

        run()
    except BaseException:
        if not stop.pressed:
            raise
    finally:
        stop.disarm()
    if stop.pressed:
        print(INTERRUPTED, file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
