"""Configuration of the site. `make docs` builds it without a network, and the built pages load nothing from one."""

import ast
import dataclasses
import gc
import inspect
import re
import textwrap
import tomllib
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

# Documents are trees of millions of nodes, none of which can be freed before the end; looking for some takes a fifth of
# the time.
gc.set_threshold(1_000_000, 50, 100)

project = "binpick"
author = "the binpick developers"
project_copyright = "the binpick developers, MIT licence"
version = release = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]["version"]

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # the equations' fonts and scripts come with the site
    "sphinx_copybutton",
]
exclude_patterns = ["_build", "_generated"]
nitpicky = False

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"binpick {release}"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
suppress_warnings = ["ref.python"]  # a name that two packages offer is the same object


def write_environments(app: Sphinx) -> None:
    """Write the environments' docstrings as Markdown, which is what they are, for the pages to include."""
    from binpick_env.env import BinPickEnv
    from policies.selection.env import GraspSelectionEnv

    for environment in (BinPickEnv, GraspSelectionEnv):
        text = re.sub(r"(?m)^#", "##", inspect.getdoc(environment) or "")
        path = Path(app.srcdir) / "_generated" / f"{environment.__name__}.md"
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def field_comments(kind: type) -> dict[str, str]:
    """Return the comment of each field of a dataclass: the one on its line, or else the lines above it."""
    source = textwrap.dedent(inspect.getsource(kind))
    lines = source.splitlines()
    (node,) = ast.parse(source).body
    found = {}
    for field in (each for each in getattr(node, "body", []) if isinstance(each, ast.AnnAssign)):
        words = re.findall(r"  # (.*)", lines[(field.end_lineno or 0) - 1])
        above = field.lineno - 2
        while not words and lines[above].lstrip().startswith("# "):
            above -= 1
        words = words or [line.strip()[2:] for line in lines[above + 1 : field.lineno - 1]]
        if words:
            found[ast.unparse(field.target)] = " ".join(words)
    return found


def list_fields(_app: Sphinx, what: str, _name: str, kind: Any, _options: Any, lines: list[str]) -> None:
    """Add the fields of a dataclass with their comments, where its docstring lists none."""
    if what != "class" or not dataclasses.is_dataclass(kind) or any(line.startswith(":ivar") for line in lines):
        return
    comments = field_comments(kind)
    if comments:
        lines += ["", *(f":ivar {name}: {text[:1].upper()}{text[1:]}" for name, text in comments.items()), ""]


def leave_out_signature(
    _app: Sphinx, what: str, _name: str, kind: Any, _options: Any, _signature: str, returned: str
) -> tuple[str, str] | None:
    """Show protocols, which are never made, without the arguments that Python gives them."""
    return ("", returned) if what == "class" and getattr(kind, "_is_protocol", False) else None


_NUMBER = r"[-+−]?\d[\d.]*"
# An interval, a count of a whole, or a number with its unit.
_FIGURE = re.compile(
    rf"\({_NUMBER} to {_NUMBER}\)|{_NUMBER} (?:of|to|/) {_NUMBER}(?: %)?|{_NUMBER} (?:%|mm|ms|s|m)(?!\w)"
)
_TAGS = r"(?:</?(?:em|span)[^>]*>|\s)*"
_ARRAY = "numpy.ndarray [ tuple [ Any , ... ] , numpy.dtype [ numpy.X ] ]"
_ARRAY_MARKUP = _TAGS.join(re.escape(word) for word in _ARRAY.split(" "))
_ARRAY_MARKUP = (
    _ARRAY_MARKUP.replace(r"numpy\.", r"(?:numpy\.)?").replace("X", r"(\w+)").replace(r"\.\.\.", r"(?:\.\.\.|…)")
)


def tidy(_app: Sphinx, _page: str, _template: str, context: dict[str, Any], _doctree: Any) -> None:
    """Write an array's type as ``NDArray[float64]``, as the code does, and mark what is not broken, or may be."""

    def short(match: re.Match[str]) -> str:
        opened: list[str] = []
        for tag in re.findall(r"<[^>]+>", match[0]):  # what is left open at the end of the match stays open
            if tag.startswith("</") and opened and not opened[-1].startswith("</"):
                opened.pop()
            else:
                opened.append(tag)
        return f"NDArray[{match[1]}]{''.join(opened)}"

    body = re.sub(_ARRAY_MARKUP, short, context.get("body", ""))
    body = body.replace('<span class="pre">--', '<span class="pre option">--')
    context["body"] = re.sub(r"(?s)(<t[dh]\b[^>]*>)(.*?)(?=</t[dh]>)", lambda cell: cell[1] + tidy_cell(cell[2]), body)


def tidy_cell(html: str) -> str:
    """Let long paths and names in a table's cell break at their joints, and its figures only between them."""
    if "<table" in html:
        return html
    code = r'(?<=<span class="pre">)[^<]{16,}'  # the others are short enough
    html = re.sub(code, lambda name: re.sub(r"(::|[/_])(?=\w)", r"\1<wbr>", name[0]), html)
    return "".join(
        text if text.startswith("<") else _FIGURE.sub(r'<span class="figure">\g<0></span>', text)
        for text in re.split(r"(<[^>]+>)", html)
    )


def setup(app: Sphinx) -> None:
    """Register what is generated before the pages are read, and what makes the reference readable."""
    app.connect("builder-inited", write_environments)
    app.connect("autodoc-process-docstring", list_fields, priority=900)  # behind napoleon
    app.connect("autodoc-process-signature", leave_out_signature)
    app.connect("html-page-context", tidy)
