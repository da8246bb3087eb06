"""Inputs that atheris chooses by the branches they reach: ``python -m tests.campaigns.guided READER -runs=100000``.

What stands behind the reader goes to atheris. What it finds is written by it into the folder it is run in; an input
is wrong by the same rules as in the campaign (`tests.campaigns.guard`). Needs ``pip install atheris``.
"""

import logging
import sys
import tempfile
from pathlib import Path

try:
    import atheris
except ImportError:
    sys.exit("this needs atheris: pip install atheris; the campaign itself does not (python -m tests.campaigns)")

ROOT = Path(__file__).parents[2]


def _compiled() -> list[str]:
    """Name the modules with compiled functions: numba knows no code that counts its branches."""
    files = [
        file for folder in ("edmsim", "controllers", "envs") for file in (ROOT / folder).rglob("*.py")
        if "edmsim.compiled" in file.read_text(encoding="utf-8")
    ]
    names = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files]
    return [name if name.startswith("edmsim.") else f"edmsim.{name}" for name in names]


COUNTED = {"include": ["edmsim"], "exclude": _compiled()}

with atheris.instrument_imports(**COUNTED):
    from .guard import judged
    from .readers import READERS


def main() -> None:
    name, *options = sys.argv[1:] or [""]
    if name not in READERS:
        sys.exit(f"there is no reader {name!r}; there are: {', '.join(READERS)}")
    reader = READERS[name]
    logging.disable()
    with tempfile.TemporaryDirectory() as place:
        folder, corpus = Path(place) / "reads", Path(place) / "corpus"
        folder.mkdir()
        corpus.mkdir()
        with atheris.instrument_imports(**COUNTED):
            for k, good in enumerate(reader.corpus):
                (corpus / str(k)).write_bytes(good)
                judged(reader.read, good, folder)  # what is imported, or compiled, when it is first needed

        def read(data: bytes) -> None:
            # code that counts its branches is several times slower: -timeout looks for hangs
            wrong = [kind for kind in judged(reader.read, data, folder)[1] if not kind.startswith("slow")]
            if wrong:
                raise RuntimeError(f"{name}: {'; '.join(wrong)}")

        limits = "-max_len=20000", "-timeout=10", "-rss_limit_mb=1024"
        atheris.Setup([sys.argv[0], str(corpus), *limits, *options], read)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
