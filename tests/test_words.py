"""Words of code and pages: names are terms of the field, and texts are in the style of Gymnasium's documentation."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from .test_house import ROOT, parsed

CODE = ("edmsim", "controllers", "envs", "models", "docs", "examples", "tests")
NAMES = {
    "afresh": "isolated, again", "asked": "requested, query", "astray": "error, deviation", "begun": "start, partial",
    "beside": "lateral, margin, comparison", "earned": "reward, return", "given": "options, overrides",
    "kept": "stored, cached, chosen", "seen": "observation, measured", "strayed": "following_error",
    "strung": "string", "swing": "oscillation", "told": "message, document, status",
    "wanted": "target, expected, requested", "whoever": "user, caller", "worth": "score, result",
}  # fmt: skip
"""Words that must not be part of a name, and what to use instead."""
PROSE = {
    r"\b[Aa]fresh\b": "again", r"\bastray\b": "out of range, away from the path",
    r"\b(?:is|are|was|were|be|been|being|if|as) told\b": "is reported, is recorded, is set",
    r"\b[Tt]old (?:of|apart|by|what)\b": "called with, distinguished, found by",
    r"\b[Ww]hoever\b": "the user, the caller, the controller",
    r"\b[Ss]o many\b": "the number's name: `count`, at most N, one in `every`",
    r"\b[Ww]hat [\w' ]{1,25} makes? of\b": "the result, the effect, the model of",
    r"\bfor want of\b": "as ... is missing",
    r"\b(?:beyond|left|out of) every reason\b": "out of range or not finite",
    r"(?<!\b[Tt]here )(?<!\bhere )\b(?:is|was|are|were) none(?=[.;,:]|$)": "is invalid, is unknown",
    r"(?<!\b[Tt]here )\bis no (?:number|constant|option|file|word|name|value|setting|share|place|policy)\b(?! of)":
        "is not a ...",
    r"\bdesign section\b": "a page that exists",
    r"\A(?:Say|Tell) (?:whether|why|what|which|how|where|that|of|for|at)\b": "Return whether, return the ...",
    r"\A[Tt]ake (?:in|over|apart|up|what|note)\b": "Read, process, parse, resume",
    r"\b[Nn]obody\b": "no controller, no process, no test; or the passive voice",
    r"\b(?:nought|whomever|come upon|put right|in name only|worth trying|hang together|turn has come)\b":
        "0, any, found, corrected, ...",
    r"\b[Bb]ut for (?:the|what|where|its|their|those|that)\b": "except, without",
    r"\b(?:is|are|was|were) wanted\b": "is expected, is needed",
    r"\b[Ww]hose drives? ha(?:s|ve) a loop\b|\bdrives? (?:with|that has|that have) a loop\b": "servo drive",
}  # fmt: skip
"""Phrases that must not appear in texts, and what to write instead."""
COMMENT = re.compile(r"#\s(.*)$", re.MULTILINE)
BLANKS = re.compile(r"\s+")


@cache
def files(ending):
    """Files of the product, its pages and examples, and tests; links within `edmsim` lead to these folders."""
    found = [file for folder in CODE for file in sorted((ROOT / folder).rglob(f"*{ending}"))]
    left_out = [ROOT / name for name in ("edmsim/controllers", "edmsim/envs", "edmsim/models", "docs/notebooks")]
    left_out += [Path(__file__), ROOT / "tests/site/test_page_words.py"]  # which list such words
    return [file for file in found if not any(map(file.is_relative_to, left_out))]


def names(tree):
    """Every name that a file defines."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name, node.lineno
            case ast.arg(arg=name) | ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield name, node.lineno


def texts(file):
    """Docstrings, messages and comments of a file, or the paragraphs of a page."""
    source = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        for node in ast.walk(parsed(file)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value, node.lineno
        for comment in COMMENT.finditer(source):
            yield comment[1], source.count("\n", 0, comment.start()) + 1
    else:
        for paragraph in re.finditer(r"\S.*?(?=\n\s*\n|\Z)", source, re.DOTALL):
            yield paragraph[0], source.count("\n", 0, paragraph.start()) + 1


@pytest.mark.slow
def test_names_are_terms_of_the_field():
    found = []
    for file in files(".py"):
        for name, line in names(parsed(file)):
            found += [
                f"{file.relative_to(ROOT)}:{line}: {name}: {NAMES[part]}"
                for part in re.split(r"_|(?<=[a-z])(?=[A-Z])", name) if part.lower() in NAMES
                for part in [part.lower()]
            ]  # fmt: skip
    assert not found, "\n".join(found)


@pytest.mark.slow
def test_texts_have_no_private_phrases():
    phrases = [(re.compile(phrase), instead) for phrase, instead in PROSE.items()]
    found = []
    for file in [*files(".py"), *files(".md"), ROOT / "README.md"]:
        for text, line in texts(file):
            flat = BLANKS.sub(" ", text)
            found += [
                f"{file.relative_to(ROOT)}:{line}: '{match[0]}': {instead}"
                for phrase, instead in phrases for match in phrase.finditer(flat)
            ]  # fmt: skip
    assert not found, "\n".join(found)
