"""Configuration of the site. `make docs` builds it without a network, and the built pages load nothing from one."""

import inspect
import re
import tomllib
from pathlib import Path

from sphinx.application import Sphinx

project = "binpick"
author = "the binpick developers"
project_copyright = "the binpick developers, MIT licence"
version = release = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]["version"]

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
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def setup(app: Sphinx) -> None:
    """Register what is generated before the pages are read."""
    app.connect("builder-inited", write_environments)
