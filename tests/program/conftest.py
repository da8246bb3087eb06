"""Fixtures that write programs and drawings and read them."""

import ezdxf
import pytest

from edmsim.program import load_program
from edmsim.program.dxf import read_dxf


@pytest.fixture
def read(tmp_path):
    """Return a function that writes G-code to ``part.ngc`` and reads it."""

    def read_text(text, **options):
        file = tmp_path / "part.ngc"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_program(file, **options)

    return read_text


@pytest.fixture
def drawing(tmp_path):
    """Return a function that draws with a callback, and reads the drawing."""

    def make(draw, units=4, version="R2010"):
        document = ezdxf.new(version)
        document.units = units
        draw(document.modelspace())
        file = tmp_path / "drawing.dxf"
        document.saveas(file)
        return read_dxf(file)

    return make


@pytest.fixture
def own_text(tmp_path):
    """Return a function that reads a drawing from the text of its entities, or from bytes of the whole file."""

    def read(entities, before=""):
        file = tmp_path / "own.dxf"
        head = "0 SECTION 2 HEADER 9 $ACADVER 1 AC1009 0 ENDSEC"
        if isinstance(entities, str):
            words = f"{head} {before} 0 SECTION 2 ENTITIES {entities} 0 ENDSEC 0 EOF".split()
            file.write_text("\n".join(words) + "\n")
        else:
            file.write_bytes(entities)
        return read_dxf(file)

    return read
