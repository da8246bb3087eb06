"""Everything that README and documentation show as code or command runs as shown.

A page runs from top to bottom in a folder of its own. Python blocks share one namespace; blocks whose first line is a
comment with a file's name are written to that file; an ``output`` block is what the block before it prints. Commands
are shortened by `commands.SHORT`. What is not run must be named here, with the reason.
"""

import re
import shutil
from pathlib import Path
from pkgutil import resolve_name

import pytest

from . import commands
from .pages import BIN, ROOT, blocks, is_command, pages, quoted, read

NOT_RUN = {
    "make test": "it runs this test",
    "source .venv/bin/activate": "a test has its environment already",
    ". .venv/bin/activate": "a test has its environment already",
    "python3 -m venv .venv": "the Makefile makes the environment the test runs in",
    ".venv/bin/pip install -c constraints.txt .[rl]": "the Makefile installs it",
    "pip install edmsim[cluster]": "the Makefile installs it", "pip install edmsim[tune]": "the Makefile installs it",
    "edmsim report out/die --face out/die.stl": "tests/recording/test_cut_face.py: a cut of 5 s has no face yet",
    "edmsim report out/die --face out/die.glb": "tests/recording/test_cut_face.py: a cut of 5 s has no face yet",
    "pip install edmsim[fmu]": "the Makefile installs it",
    "ray start --head": "tests/sweep/test_sweep_cluster.py starts one",
    "edmsim sweep run sweep.toml --out out/sweep --ray auto": "tests/sweep/test_sweep_cluster.py",
    "edmsim tune training edmsim/GapFeed-v2 --steps 20000 --out out/tune-ppo": "tests/sweep/test_tune.py trains",
    "pip install edmsim[cluster,rl,tune]": "the Makefile installs it",
    "edmsim tune population edmsim/GapFeed-v2 --learners 8 --generations 10 --steps 200000 --out out/population":
        "tests/sweep/test_sweep_cluster.py trains one",
    "python -m tests.campaigns gcode --only 17": "tests/campaigns/test_campaigns.py gives such inputs",
    "edmsim tune technology tool-steel --height 10 --passes 2 --out steel.toml":
        "tests/evaluation/test_technology_search.py",
    "edmsim cut examples/punch.ngc --passes 2 --height 10 --technology steel.toml --out out/punch-2":
        "it takes what the command before it leaves; tests/evaluation/test_technology_search.py",
    "edmsim train edmsim/MaxRateShift-v0 --algo bandit --score 4 --seed 100 --out out/adapt":
        "tests/learning/test_bandit_training.py runs a short one",
    "edmsim train edmsim/MaxRateShift-v0 --algo bandit --settings own.toml --score 0 --out out/own":
        "tests/learning/test_bandit_training.py runs one with settings of its own",
    "edmsim evaluate edmsim/MaxRateShift-v0 --controllers policy:out/adapt/policy.json,adaptive-hold --seeds 4 "
    "--page out/adapt/compared.md": "it takes what the command before it leaves",
    "python examples/learning/lag.py --machines 400 --rounds 3 --epochs 80 --seed 1 --out out/lag":
        "tests/learning/test_lag_example.py runs its parts",
    "edmsim evaluate edmsim/Corner-v3 --controllers policy:out/lag/policy.json":
        "it takes what the command before it leaves",
    "edmsim cut examples/punch.ngc --out out/punch --resume":
        "tests/test_nothing_lost.py interrupts cuts: here none is interrupted",
    "edmsim report out/punch --screenshots shots": "tests/recording/test_playback.py, where there is Vulkan",
}  # fmt: skip
"""Commands of blocks that are checked but not run, and why."""
ELSEWHERE = {
    "session": "tests/consoles/computer_1982/test_terminal_docs.py",
    "program": "tests/consoles/computer_1982/test_terminal_docs.py",
    "tape": "tests/consoles/computer_1982/test_terminal_docs.py",
    "text": "tests/program/test_dialect_pages.py",
}
"""Kinds of blocks that other tests run."""
BEFORE: dict[str, tuple[str, ...]] = {
    "docs/playback.md": (
        "edmsim cut examples/punch.ngc --out out/punch", "edmsim cut examples/punch.ngc --seed 1 --out out/fixed",
    ),
}  # fmt: skip
"""What a page takes for done: the cuts that README's commands leave."""
TEXT_FILES = {"docs/terminal.md": {"program.txt": "TI 30 TP 100\nNEW 1300 1000\nEND\n", "job.txt": "HELP\nBYE\n"}}
"""Files that the commands of a page read and a reader writes."""
FINISHED, BAD_INPUT, TIME_LIMIT = 0, 2, 3
PAGES = [page for page in pages() if blocks(page)]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("page", [page for page in PAGES if {block.kind for block in blocks(page)} - set(ELSEWHERE)])
@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")  # of stable-baselines3 and torch
def test_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch, capfd, short_training):
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # as a Python that is begun in the folder has it
    commands.replaced(monkeypatch)
    for name, text in TEXT_FILES.get(page, {}).items():
        Path(name).write_text(text, encoding="utf-8")
    for line in BEFORE.get(page, ()):
        _run(line.split(), f"{page}:0", {FINISHED, TIME_LIMIT}, capfd)
    namespace = {"__name__": "__main__"}
    shown = [block for block in blocks(page) if block.kind not in ELSEWHERE]
    for block, following in zip(shown, [*shown[1:], None], strict=True):
        expected = following.text if following is not None and following.kind == "output" else None
        printed = _do(block, namespace, expected, capfd)
        if expected is not None:
            assert printed.split() == expected.split(), f"{block.place} prints\n{printed}"


def _do(block, namespace, expected, capfd):
    """Do what a block shows; returns what it prints."""
    if block.kind == "output":
        return block.text
    if block.file is not None:
        Path(block.file).write_text(block.text + "\n", encoding="utf-8")
        return ""
    if block.kind == "python":
        capfd.readouterr()
        exec(compile("\n" * int(block.place.split(":")[1]) + block.text, block.place, "exec"), namespace)
        return capfd.readouterr().out
    refused = expected is not None and expected.startswith("edmsim: ")
    printed = ""
    for words in block.commands:
        if " ".join(words) in NOT_RUN:
            continue
        for line in commands.recipe(words[1]) if words[0] == "make" else [words]:
            printed += _run(line, block.place, {BAD_INPUT} if refused else {FINISHED, TIME_LIMIT}, capfd)
    return printed


def _run(words, place, allowed, capfd):
    capfd.readouterr()
    status = commands.run(words, read(place.split(":")[0]))
    out, err = capfd.readouterr()
    assert status in allowed, f"{place}: {' '.join(words)}\n{out}{err}"
    return out + err


def test_every_block_is_of_a_kind_that_is_run_and_can_be_compiled():
    for page in PAGES:
        for block in blocks(page):
            assert block.kind in {"python", "sh", "output", *ELSEWHERE} or block.file is not None, block.place
            if block.kind == "python":
                compile(block.text, block.place, "exec")


def test_every_command_is_run_or_left_out_for_a_reason():
    shown = {" ".join(words): block for page in PAGES for block in blocks(page) if block.kind == "sh"
             for words in block.commands}  # fmt: skip
    for line, block in shown.items():
        runs = line.split()[0].removeprefix(BIN) == "edmsim" or (
            line.startswith("make ") and commands.recipe(line.split()[1])
        )
        assert runs or line in NOT_RUN, f"{block.place}: no test runs {line!r}"
    assert set(shown) >= set(NOT_RUN), "NOT_RUN names commands that no page shows any more"


def test_the_tables_above_name_pages_and_blocks_that_are_there():
    assert set(PAGES) >= {*BEFORE, *TEXT_FILES}
    assert {block.kind for page in PAGES for block in blocks(page)} >= set(ELSEWHERE)


@pytest.mark.parametrize("page", pages())
def test_every_command_names_what_there_is(page):
    for block in blocks(page):
        for words in block.commands if block.kind == "sh" else []:
            commands.check(words)
    for code in filter(is_command, quoted(page)):
        commands.check(re.sub(r"['\"]", "", code).split())


@pytest.mark.parametrize("page", pages())
def test_every_name_between_backticks_is_there(page):
    for code in quoted(page):
        if re.fullmatch(r"edmsim(\.\w+)+(\(.*\))?", code):
            resolve_name(code.split("(")[0])
        elif re.fullmatch(r"(edmsim|controllers|envs|models|examples|tests|docs)/[\w/-]*(\.\w+|/)", code):
            assert re.search("NAME|FILE", code) or (ROOT / code).exists(), code


def test_pictures_shown_are_pictures():
    shown = [(page, place) for page in pages() for place in re.findall(r"!\[.*?\]\((.*?)\)", read(page))]
    assert len(shown) > 7
    for page, place in shown:
        file = (ROOT / page).parent / place
        assert file.read_bytes().startswith((b"\x89PNG", b"GIF8")), file
