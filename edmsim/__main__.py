"""The command ``edmsim``, also as ``python -m edmsim`` where only the interpreter is on the path."""

import sys

from edmsim.errors import INTERRUPTED
from edmsim.signals import raise_again


def main() -> None:
    """Run the command line, which Ctrl-C also ends in silence while its modules are still loaded."""
    sys.unraisablehook = raise_again
    try:
        from edmsim.cli.app import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
