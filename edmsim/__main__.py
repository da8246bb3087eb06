"""The command ``edmsim``; also for ``python -m edmsim``."""

import sys

from edmsim.errors import INTERRUPTED
from edmsim.signals import raise_again


def main() -> None:
    """Run the command line; Ctrl-C ends it without a traceback even while its modules are imported."""
    sys.unraisablehook = raise_again
    try:
        from edmsim.cli.app import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
