"""Sphinx settings of the documentation: MyST pages and notebooks, the pydata theme, formulas by a bundled MathJax."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

from docutils import nodes
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))

from reference_pages import draw_schemes, named_pages, write_pages  # beside this file

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
exclude_patterns = ["_build", "**.ipynb_checkpoints", "reference/parts/*"]

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


def link_names(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Link each name of a scheme or a top that is written as code to its page."""
    targets = named_pages(page)
    for literal in list(doctree.findall(nodes.literal)):
        target = targets.get(literal.astext())
        inside = literal.parent
        while inside is not None and not isinstance(inside, (nodes.title, nodes.reference)):
            inside = inside.parent
        if target and target != page and inside is None:
            link = nodes.reference("", "", internal=True, refuri=app.builder.get_relative_uri(page, target))
            literal.replace_self(link)
            link += literal


def write_reference(app: Sphinx) -> None:
    """Write the generated pages and draw their pictures."""
    folder = Path(app.srcdir) / "reference"
    write_pages(folder)
    draw_schemes(folder)


def setup(app: Sphinx) -> None:
    """Write the generated pages before pages are read; show blocks of CSV as plain text; link names to their pages."""
    app.add_lexer("csv", TextLexer)
    app.connect("builder-inited", write_reference)
    app.connect("doctree-resolved", link_names)
