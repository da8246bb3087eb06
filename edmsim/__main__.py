"""``python -m edmsim`` is the command ``edmsim``, where only the interpreter is on the path."""

from edmsim.cli.app import main

main()
