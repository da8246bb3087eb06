"""Jobs that raise errors, and jobs that kill the process they are done in, for other processes to import."""

import os
import signal
from pathlib import Path

from edmsim.errors import EdmsimError, InputError


class UnportableError(EdmsimError):
    """An error that cannot be made again from its text."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} and {second}")


ERRORS = {
    "input": InputError("there is no such wire", "cut.toml", 3), "own": ZeroDivisionError("in a user's law"),
    "unportable": UnportableError("this", "that"),
}  # fmt: skip


def answer(job: str) -> dict[str, str]:
    """Return the job in a row, or raise its error."""
    if job in ERRORS:
        raise ERRORS[job]
    return {"job": job}


def unreadable(job: str) -> UnportableError:
    """Return what cannot be made again."""
    return UnportableError(job, job)


def dies_once(job: Path) -> str:
    """Die at the first attempt."""
    if not job.exists():
        job.write_text("begun")
        os.kill(os.getpid(), signal.SIGKILL)
    return job.name


def dies(job: int) -> int:
    """Die at every attempt except number 3."""
    print("what a user's code prints goes elsewhere")
    if job != 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return job
