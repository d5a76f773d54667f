"""Sphinx: the site, built by ``scripts/docs.sh`` with warnings as errors."""

import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "extensions"), str(HERE.parent)]

from docutils import nodes  # noqa: E402
from sphinx_gallery.directives import imgsgnode  # noqa: E402

import ringwear_par as rw  # noqa: E402

project = "ringwear-par"
author = "the ringwear-par developers"
version = release = rw.__version__
language = "en-GB"

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "sphinx_copybutton",
    "case_words",
    "docstrings",
    "llms",
    "mathml",
    "measured",
    "search_texts",
]
exclude_patterns = ["_build", "gallery", "extensions", "generated/**/*.py"]
exclude_patterns += ["package.md"]  # which package indexes show
nitpicky = True
# types of other packages: looking them up would need the network
nitpick_ignore_regex = [
    (r"py:.*", r"(collections|h5py|matplotlib|mpi4py|numpy|os|pathlib|typing|xarray)\..*"),
    (r"py:.*", r"(Ensemble|Figure|InferenceData|Path)"),
    # of the package's own rooms, which have no pages
    (r"py:.*", r"ringwear_par\.\w+\..*"),
]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
html_math_renderer = "mathml"
smartquotes = False  # texts of files, options and messages stay as they are typed

autosummary_generate = True
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
templates_path = ["templates"]

html_theme = "furo"
html_title = f"ringwear-par {version}"
html_show_copyright = html_copy_source = html_show_sourcelink = False
html_show_search_summary = True
html_static_path = ["static"]
html_css_files = ["site.css"]
copybutton_exclude = ".linenos, .gp, .go"


def gallery_style(config: dict[str, Any], name: str) -> None:
    """Give all pictures of the gallery one style, to be read in grey print as well."""
    import matplotlib as mpl
    from cycler import cycler

    from ringwear_par.pictures.style import COLOURS, DASHES, STYLE

    mpl.rcParams.update(STYLE)
    mpl.rcParams["axes.prop_cycle"] = cycler(color=COLOURS) + cycler(linestyle=DASHES)
    mpl.rcParams["legend.frameon"] = False
    mpl.rcParams["figure.constrained_layout.use"] = True


sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "generated/gallery",
    "reset_modules": ("matplotlib", gallery_style),
    "abort_on_example_error": False,
    "download_all_examples": False,
    "within_subsection_order": "FileNameSortKey",
    "show_memory": False,
    "remove_config_comments": True,
    "write_computation_times": False,
    "min_reported_time": 3600,
    "show_signature": False,
}
# of sphinx_gallery's functions, which Sphinx cannot keep between two builds
suppress_warnings = ["config.cache", "sphinx_gallery.space_in_filename"]


def _described(app: Any, page: Any) -> None:
    """Give the pictures of the gallery's scripts the title of their page as alternative text."""
    if app.env.docname.startswith("generated/gallery/plot_"):
        title = next(page.findall(nodes.title)).astext()
        for picture in page.findall(imgsgnode):
            picture["alt"] = title


def setup(app: Any) -> None:
    """Register it."""
    app.connect("doctree-read", _described)
