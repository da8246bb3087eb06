"""Commands run in this process, with a script in a pipe as their standard input."""

import os
import sys
from types import SimpleNamespace

import pytest

from edmsim.cli import app as cli


@pytest.fixture
def piped(monkeypatch, capfdbinary):
    """Run ``edmsim`` with a script: its exit status, and its output and errors as bytes and as text."""

    def run(script, *words):
        monkeypatch.setattr(sys, "argv", ["edmsim", *map(str, words)])
        before, (reading, writing) = os.dup(0), os.pipe()
        os.write(writing, script)
        os.close(writing)
        os.dup2(reading, 0)
        try:
            with pytest.raises(SystemExit) as left:
                cli.main()
        finally:
            os.dup2(before, 0)
            os.close(before)
            os.close(reading)
        out, err = capfdbinary.readouterr()
        text = out.decode("latin-1"), err.decode()
        return SimpleNamespace(returncode=left.value.code or 0, stdout=out, stderr=err, text=text)

    return run


def recorded_curve(file, name):
    """Return a curve of a scope's recording as rerun reads it back."""
    from rerun.chunk import RrdReader

    drawn = []
    for chunk in RrdReader(str(file)).stream().to_chunks():
        if chunk.entity_path == f"/{name}":
            batch = chunk.to_record_batch()
            drawn += [value for row in batch.column("Scalars:scalars").to_pylist() for value in row]
    return drawn
