"""The site, from pages, notebooks and docstrings: `sphinx-build -W notebooks site`."""

import os
import sys
from importlib.metadata import version as installed
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import _reference  # noqa: E402

project, author = "tomojax", "the tomojax authors"
copyright = author
version = release = installed("tomojax")

extensions = [
    "myst_nb",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx.ext.mathjax",
]
exclude_patterns = ["_*", "conf.py", "results/**", "reference/_*"]
root_doc = "index"
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}

nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
# `.ci/run` names a folder that holds the outputs of the same notebooks and packages.
nb_execution_mode = "cache" if "TOMOJAX_NOTEBOOKS" in os.environ else "force"
nb_execution_cache_path = os.environ.get("TOMOJAX_NOTEBOOKS", "")
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True
# A notebook's own pictures are its output: a warning in one is a mistake of the page.
nb_execution_show_tb = True

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "attrs_inline"]
myst_heading_anchors = 3
myst_dmath_double_inline = True
suppress_warnings = ["mystnb.unknown_mime_type"]

html_theme = "pydata_sphinx_theme"
html_title = "tomojax"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "header_links_before_dropdown": 7,
}
html_sidebars = {"index": [], "start": []}
html_show_sourcelink = False
smartquotes = False  # would make a dash of the two hyphens of an option
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


def setup(app):
    app.connect("builder-inited", lambda app: _reference.write(HERE / "reference"))
