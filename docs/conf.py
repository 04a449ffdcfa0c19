"""docs/ and the README as a site: `make docs`. Nothing is fetched when it is built, and nothing when it is read."""

import hashlib
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "docs" / "_extensions")]  # agents/ is no part of the package

import bicycle_env  # noqa: E402

project = "bicycle-env"
version = release = bicycle_env.__version__
copyright = "the authors of bicycle-env; MIT licence"
extensions = [
    "myst_nb",  # Markdown, and what it has to run: gallery.md and notebooks/
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinxcontrib.katex",
    "generated",
]
exclude_patterns = ["_extensions", "_static"]

# Markdown as GitHub shows it
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4

# What is run: anew when its lines change, or the code behind them
digest = hashlib.sha256()
for source in sorted([*(ROOT / "bicycle_env").rglob("*.py"), *(ROOT / "agents").rglob("*.py")]):
    digest.update(source.read_bytes())
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "build" / f"notebooks-{digest.hexdigest()[:12]}")
nb_execution_show_tb = True  # a cell that fails is a warning, hence an error
nb_execution_timeout = -1  # none
nb_merge_streams = True
nb_ipywidgets_js = {}  # from another host; no widget is used

# Docstrings
default_role = "literal"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
toc_object_entries_show_parents = "hide"
napoleon_use_rtype = False  # what is returned is described in words, not by types to be looked up
napoleon_custom_sections = [("Returns, raises", "params_style")]

katex_css_path = "katex/katex.min.css"  # and its fonts: docs/_static/katex; the js comes with the extension

html_theme = "furo"
html_title = "bicycle-env"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
