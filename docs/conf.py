"""The site, as Sphinx builds it: make docs."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "synthcam"
author = copyright = "The synthcam developers"
version = release = version_of("synthcam")
html_title = f"synthcam {release}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "generated", "mathml"]
root_doc = "index"
exclude_patterns = ["extensions"]

# A reference that leads nowhere is an error, as is every other warning (make docs passes -W).
nitpicky = True
suppress_warnings = ["toc.empty_glob"]  # a page that another branch will bring
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
myst_number_code_blocks: list[str] = []

default_role = "code"  # one backtick in a docstring
autodoc_typehints = "none"  # the docstrings say what goes in and out, with shapes and units
autodoc_preserve_defaults = True
numpydoc_show_class_members = False  # each has an entry of its own
html_math_renderer = "mathml"

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}
html_copy_source = False
html_show_sourcelink = False
pygments_style, pygments_dark_style = "default", "monokai"

linkcheck_timeout = 20
linkcheck_workers = 4
linkcheck_anchors = False
