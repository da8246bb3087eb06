"""The command ``edmsim``; also for ``python -m edmsim``."""

import sys

from edmsim import errors, signals


def main() -> None:
    """Run the command line; Ctrl-C ends it without a traceback even while its modules are imported."""
    sys.unraisablehook = signals.raise_again
    try:
        from edmsim.cli.app import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(errors.INTERRUPTED)


if __name__ == "__main__":
    main()
