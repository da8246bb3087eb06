"""``python -m edmsim`` is the command ``edmsim``, for whoever has an interpreter but not its scripts on the path."""

from edmsim.cli.app import main

main()
