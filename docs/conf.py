"""How Sphinx makes the documentation site from this folder: `make docs`.

The pages are plain Markdown, read in the repository as well; what the site needs beyond that happens here.
"""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel
from pygments.lexers.special import TextLexer
from sphinx.util.nodes import make_refnode

import edmsim

sys.path.append(str(Path(__file__).parent / "make"))
from field_comments import declared_fields

if TYPE_CHECKING:
    from docutils.nodes import Element, TextElement
    from sphinx.addnodes import pending_xref
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

DOCS = Path(__file__).parent
ROOT = DOCS.parent
ARRAY = re.compile(r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[(.*?)\]\]")
"""How an array's type reads when it is spelt out."""
COLON = "\N{PROPORTION} "
"""Stands for a colon while napoleon looks."""

FIELD = re.compile(r' +\("(\w+)", "(\w+)"(?:, \w+)?\),(?:  # (.*))?')
"""A field of a record, as it is declared in a line."""

project = "edmsim"
copyright = "the authors of edmsim, MIT licence"
version = release = edmsim.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon", "sphinx_copybutton"]
highlight_language = "none"
smartquotes_action = "De"  # dashes, not quotation marks: what is quoted may be copied



def repository() -> str:
    """Return the address of the repository that this checkout was cloned from; empty where a browser finds none."""
    command = ["git", "-C", str(ROOT), "remote", "get-url", "origin"]
    try:
        address = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        return ""
    address = re.sub(r"^(?:ssh://)?git@([\w.-]+)[:/]", r"https://\1/", address).removesuffix(".git")
    return re.sub(r"^https://[^/]*@", "https://", address) if address.startswith("https://") else ""


html_theme = "furo"
html_theme_options = {
    "footer_icons": [
        {"name": "repository", "url": url, "html": "repository", "class": ""} for url in [repository()] if url
    ],
}
html_title = f"edmsim {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
copybutton_exclude = ".linenos, .gp, .go, .c1"  # a command's comment is not pasted with it

myst_heading_anchors = 4
nb_execution_mode = "off"  # the committed outputs are shown; the tests execute
nb_merge_streams = True
nb_render_markdown_format = "myst"  # links of outputs lead to pages, too

default_role = "py:obj"
python_maximum_signature_line_length = 90
autosummary_generate = False
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_google_docstring = False
napoleon_use_param = False  # types of the docstrings are prose: shapes, ranges
napoleon_use_rtype = False
napoleon_custom_sections = [
    ("Attributes", "params_style"), "Description", "Action space", "Observation space", "Reward", "Starting state",
    "End of the episode", "Arguments", "Versions",
]


def copy_notebooks(into: Path) -> None:
    """Copy the notebooks into the site's folder, with a page that lists them, if there are any."""
    into.mkdir(exist_ok=True)
    found = {file.name: file.read_text(encoding="utf-8") for file in (ROOT / "notebooks").glob("*.ipynb")}
    table = ".. include:: ../../notebooks/README.md\n   :parser: myst_parser.sphinx_\n"
    found["index.rst"] = table if (ROOT / "notebooks" / "README.md").is_file() else "Notebooks\n=========\n"
    for old in into.iterdir():
        if old.name not in found:
            old.unlink()
    for name, text in found.items():
        file = into / name
        if not file.is_file() or file.read_text(encoding="utf-8") != text:  # Sphinx reads what is new
            file.write_text(text, encoding="utf-8")


def turn_links(text: str, page: str) -> str:
    """Lead links out of this folder to the same things in the site, and those from the root into it.

    Files of the repository without a page become downloads; folders have nothing to lead to.
    """
    up = "../" * page.count("/")
    if page.startswith("notebooks/"):  # written to be read in the repository's notebooks/; JSON or Markdown
        text = re.sub(r"\]\(\.\./(docs/)?", lambda m: "](../" if m[1] else "](../../", text)
    elif page == "changelog":
        text = text.replace("](docs/", "](")
    for there, here in (("notebooks/README.md", "notebooks/index.rst"), ("notebooks/", "notebooks/"),
                        ("README.md", "index.md"), ("CHANGELOG.md", "changelog.rst")):  # fmt: skip
        text = text.replace(f"]({up}../{there}", f"]({up}{here}")
    near = (DOCS / page).parent
    return re.sub(r"\[([^][]+)\]\(([\w./-]+)\)", lambda m: m[1] if (near / m[2]).is_dir() else m[0], text)


def read_page(app: Sphinx, page: str, source: list[str]) -> None:
    """Turn a page's links; of the first page's parts, leave out a folder without pages, which Sphinx complains of."""
    source[0] = turn_links(source[0], page)

    def part(line: re.Match[str]) -> str:
        return line[0] if any(file.stem != "index" for file in (DOCS / line[1]).glob("*")) else ""

    if page == "index":
        app.env.note_reread()  # folders may fill without this page being changed
        source[0] = re.sub(r"^([\w-]+)/\*\n", part, source[0], flags=re.MULTILINE)


def read_included(_: Sphinx, __: Path, page: str, source: list[str]) -> None:
    """Turn the links of a page's included file."""
    source[0] = turn_links(source[0], page)


def know_types() -> None:
    """Import what modules import for annotations alone, so that these can be resolved."""
    for page in (DOCS / "api").glob("*.rst"):
        for name in re.findall(r"currentmodule:: (.*)", page.read_text(encoding="utf-8")):
            package = import_module(name)
            for public in getattr(package, "__all__", ()):
                getattr(package, public)  # some load when they are asked for
    modules = [m for name, m in sys.modules.items() if name.partition(".")[0] == "edmsim" and m.__file__]
    known: dict[str, Any] = {}
    for module in modules:
        for node in ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8")).body:
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                names: dict[str, Any] = {}
                exec(compile(ast.Module(node.body, []), str(module.__file__), "exec"), vars(module), names)
                vars(module).update(names)
                known |= names
    for module in modules:  # an alias is looked up where it is used, not where it was written
        for name, value in known.items():
            vars(module).setdefault(name, value)


def skip(_: Sphinx, __: str, name: str, member: object, skipped: bool, ___: object) -> bool | None:
    """Leave out fields of named tuples, which the class describes, and the models' configuration."""
    field = (getattr(member, "__doc__", None) or "").startswith("Alias for field")
    return True if field or name == "model_config" else None


def sign(
    _: Sphinx, __: str, ___: str, subject: object, ____: object, annotated: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Write arrays as they are written; leave out the constructors of validated models: they are read from files."""
    if isinstance(subject, type) and issubclass(subject, BaseModel):
        return "", None

    def short(text: str | None) -> str | None:
        return text and ARRAY.sub(r"~numpy.typing.NDArray[\1]", text)

    return short(annotated), short(returned)


def keep_colons(_: Sphinx, kind: str, __: str, ___: object, ____: object, lines: list[str]) -> None:
    """Hide the colons of a property's first line from napoleon, which takes what stands before one for a type."""
    if kind in ("attribute", "data", "property"):
        lines[:1] = [line.replace(": ", COLON) for line in lines[:1]]


def show_colons(_: Sphinx, __: str, ___: str, ____: object, _____: object, lines: list[str]) -> None:
    """Put the colons back."""
    lines[:1] = [line.replace(COLON, ": ") for line in lines[:1]]


def show_fields(_: Sphinx, __: str, name: str, subject: object, ___: object, lines: list[str]) -> None:
    """Describe a record's fields as comments behind and above them do, where it is declared."""
    if not isinstance(subject, np.dtype) or subject.names is None:
        return
    module, _, record = name.rpartition(".")
    source = inspect.getsource(import_module(module)).partition(f"\n{record} = np.dtype(")[2].partition("\n)\n")[0]
    for line in source.splitlines():
        if found := FIELD.match(line):
            what = f"{found[2]}, {subject[found[1]].shape[0]} of them" if subject[found[1]].shape else found[2]
            lines += ["", f"``{found[1]}`` : {what}", *([f"    {found[3]}"] if found[3] else [])]
        elif found := re.match(r" +# (.*)", line):
            lines += ["", f"*{found[1][:1].upper()}{found[1][1:]}*"]


def list_fields(_: Sphinx, __: str, ___: str, subject: object, ____: object, lines: list[str]) -> None:
    """List a record's fields as attributes, with the comments behind or above them, if it has any."""
    is_record = isinstance(subject, type) and (
        is_dataclass(subject) or hasattr(subject, "_fields") or hasattr(subject, "__total__")  # of a TypedDict
    )
    if not (is_record or (isinstance(subject, type) and issubclass(subject, BaseModel))) or "Attributes" in lines:
        return
    fields = [field for field in declared_fields(subject) if not field.is_state]
    if not any(field.meaning for field in fields):
        return
    lines += ["", "Attributes", "----------"]
    for names, kind, meaning, _ in fields:
        kind = re.sub(r"^Annotated\[(.*), \w+(?:\(.*\))?\]$", r"\1", kind)
        lines += [f"{', '.join(names)} : {kind}", *([f"    {meaning.rstrip('.')}."] if meaning else [])]
    lines += [""]


def known_name(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, shown: TextElement
) -> Element | None:
    """Find a class by its bare name; complain of an unknown name of edmsim; leave others as they are.

    Docstrings name parameters, files and private modules in single backticks as well as what has an entry here.
    """
    target = node["reftarget"]
    if node.get("refdomain") != "py" or (target.startswith("edmsim.") and not exists(target)):
        return None
    places = {entry[:2] for name, entry in env.domains["py"].data["objects"].items() if name.endswith(f".{target}")}
    if target[:1].isupper() and len(places) == 1:
        page, anchor = places.pop()
        return make_refnode(app.builder, node["refdoc"], page, anchor, shown)
    return shown


def exists(name: str) -> bool:
    """Whether a dotted name is a module or something in one."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: Any = import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            fields = getattr(found, "__dataclass_fields__", {}) | getattr(found, "model_fields", {})
            if part not in fields and not hasattr(found, part):
                return False
            found = inspect.getattr_static(found, part, None)
        return True
    return False


def keep_options(_: Sphinx, __: str, ___: str, context: dict[str, Any], ____: object) -> None:
    """Mark options of commands, so that a narrow page does not break them at their hyphens."""
    def marked(code: re.Match[str]) -> str:
        return re.sub(r"(?<=[\s>])(--[a-z][\w-]*)", r'<span class="option">\1</span>', code[0])

    context["body"] = re.sub(r"<pre>.*?</pre>", marked, context.get("body", ""), flags=re.DOTALL)


def setup(app: Sphinx) -> None:
    """Hook the above into the build."""
    copy_notebooks(DOCS / "notebooks")
    know_types()
    for language in ("session", "program", "tape", "output"):
        app.add_lexer(language, TextLexer)
    app.connect("source-read", read_page)
    app.connect("include-read", read_included)
    app.connect("autodoc-skip-member", skip)
    app.connect("autodoc-process-signature", sign)
    app.connect("autodoc-process-docstring", keep_colons, priority=400)  # napoleon's own is 500
    app.connect("autodoc-process-docstring", show_colons, priority=600)
    app.connect("autodoc-process-docstring", list_fields, priority=400)
    app.connect("autodoc-process-docstring", show_fields, priority=700)
    app.connect("missing-reference", known_name)
    app.connect("html-page-context", keep_options)
