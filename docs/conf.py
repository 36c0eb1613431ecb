"""Sphinx settings of the documentation: MyST pages and notebooks, the pydata theme, formulas by a bundled MathJax."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))

from reference_pages import write_parts  # beside this file

project = "topcli"
author = "the topcli authors"
copyright = author
version = release = version_of("topcli")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
]
autodoc_typehints = "none"
myst_enable_extensions = ["dollarmath", "deflist", "substitution"]
myst_substitutions = {"version": version}
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
exclude_patterns = ["_build", "**.ipynb_checkpoints", "reference/*"]

html_theme = "pydata_sphinx_theme"
html_title = f"topcli {version}"
html_show_sourcelink = False
html_context = {"default_mode": "auto"}
html_static_path = ["_static"]
html_css_files = ["topcli.css"]
templates_path = ["_templates"]
html_sidebars = {"**": ["contents.html"]}
html_theme_options = {
    "navigation_with_keys": False,
    "navbar_center": [],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}


def setup(app: Sphinx) -> None:
    """Write the parts of the reference before pages are read; show blocks of CSV as plain text."""
    app.add_lexer("csv", TextLexer)
    app.connect("builder-inited", lambda app: write_parts(Path(app.srcdir) / "reference"))
