"""A process that does jobs: ``python -m edmsim.sweep.worker MODULE:FUNCTION``, jobs and answers pickled in a pipe."""

from __future__ import annotations

import os
import pickle
import queue
import sys
import threading
from importlib import import_module
from typing import Any, BinaryIO


def main(name: str) -> None:
    """Run jobs until the pipe is closed, which also ends a job in progress."""
    module, _, attribute = name.partition(":")
    function = getattr(import_module(module), attribute)
    source = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a user's code prints goes where a person sees it, and not between the answers
    jobs: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(source, jobs), daemon=True).start()
    while True:
        pickle.dump(function(jobs.get()), answers)
        answers.flush()


def _read(source: BinaryIO, jobs: queue.SimpleQueue[Any]) -> None:
    while True:
        try:
            jobs.put(pickle.load(source))
        except (EOFError, OSError):
            os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1])
