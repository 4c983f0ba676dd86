"""Documentation site: `make docs` writes it to results/docs and takes no warning."""

import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from grainfall import __version__

project = "grainfall"
copyright = "2026 The grainfall authors"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["equations.css"]
html_title = f"grainfall {release}"


def equation(translator, node):
    """Write an equation as MathML, which a browser draws by itself, without a script or a network.

    What docutils does not know is a warning; but it reads \\tfrac12 wrongly: write arguments in braces.
    """
    try:
        mathml = tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block))
    except MathError as fault:
        logging.getLogger(__name__).warning("%s", fault, location=node)
    else:
        translator.body.append(mathml)
    raise nodes.SkipNode


def setup(app):
    app.add_html_math_renderer("mathml", (equation, None), (equation, None))
