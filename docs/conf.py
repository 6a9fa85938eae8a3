"""Configuration of the documentation."""

import os
import sys
import warnings
from importlib.metadata import version as installed_version
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
sys.path.insert(0, os.path.abspath("."))
sys.path.insert(0, os.path.abspath(os.path.join("..", "benchmarks")))

from cheat_sheet import draw_cheat_sheet
from citations import add_keys, read_references
from loop_picture import draw_loop, write_report
from recordings import SHARED
from signatures import draw_signatures, draw_thumbnail

project = "skhyst"
author = "The skhyst developers"
copyright = "The skhyst developers"
release = version = installed_version("skhyst")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "mathml",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.bibtex",
]
bibtex_bibfiles = ["references.bib"]
exclude_patterns = [
    "_build",
    "auto_examples/**/*.ipynb",
    "**/sg_execution_times.rst",  # its table fetches scripts
    "sg_execution_times.rst",
]
templates_path = ["_templates"]
default_role = "literal"
html_math_renderer = "mathml"

autosummary_generate = True
autosummary_ignore_module_all = False  # a page shows the names in __all__, wherever they are from
autosummary_imported_members = True
autodoc_typehints = "none"
numpydoc_show_class_members = False


def _examples_to_run():
    """Return a pattern of the examples' paths: those of recordings where their folder is named.

    With SKHYST_GALLERY=papers only those of the papers, where the tests run all others.
    """
    if os.environ.get("SKHYST_GALLERY") == "papers":
        return r"[\\/]papers[\\/]plot_"
    names = [path.stem for path in Path("../examples/recordings").glob("plot_*.py")]
    named = "SKHYST_DATA" in os.environ
    absent = [
        name for name in names if not (named and (SHARED / name.removeprefix("plot_")).exists())
    ]
    return rf"[\\/](?!({'|'.join(absent)})\.py)plot_" if absent else r"[\\/]plot_"


sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "auto_examples",
    "filename_pattern": _examples_to_run(),
    "ignore_pattern": r"^_",
    "abort_on_example_error": True,
    "default_thumb_file": os.path.abspath("pictures/thumbnail.png"),
    "show_memory": False,
    "download_all_examples": False,
    "within_subsection_order": "NumberOfCodeLinesSortKey",
    "doc_module": ("skhyst",),
    "backreferences_dir": "api/generated/backreferences",
    "reset_modules": ("matplotlib",),
}

html_theme = "pydata_sphinx_theme"
html_title = "skhyst"
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 7,
    "navbar_persistent": ["search-button"],  # a field would not stand in the same line
}
html_static_path = ["_static"]
html_css_files = ["skhyst.css"]
html_show_sourcelink = False

warnings.filterwarnings("error", module="skhyst")


def _drop_guide_links(app, what, name, obj, options, lines):
    """Leave out links of scikit-learn's docstrings to its user guide, which is not here."""
    if (getattr(obj, "__module__", None) or "").startswith("sklearn."):
        lines[:] = [line for line in lines if not line.startswith("Read more in the :ref:")]


def _draw_pictures(app):
    """Draw what the pages show, where a script is newer than its pictures."""
    folder, static = Path(app.srcdir) / "pictures", Path(app.srcdir) / "_static"
    for draw, script, target in (
        (draw_signatures, "signatures.py", folder / "effects"),
        (draw_thumbnail, "signatures.py", folder / "thumbnail.png"),
        (draw_loop, "loop_picture.py", folder / "loop.svg"),
        (write_report, "loop_picture.py", static / "sample_report.html"),
        (draw_cheat_sheet, "cheat_sheet.py", folder / "cheat_sheet.svg"),
        (draw_cheat_sheet, "cheat_sheet.py", folder / "cheat_sheet.pdf"),
    ):
        made = target.stat().st_mtime if target.exists() else 0.0
        if made < Path(app.srcdir, script).stat().st_mtime:
            target.parent.mkdir(parents=True, exist_ok=True)
            draw(target)


REFERENCES = read_references()


def _link_citations(app, what, name, obj, options, lines):
    """Add the keys of the bibliography to the citations of a docstring."""
    lines[:] = add_keys("\n".join(lines), REFERENCES).split("\n")


def _link_citations_of_page(app, docname, source):
    source[0] = add_keys(source[0], REFERENCES)


def setup(app):
    app.connect("builder-inited", _draw_pictures, priority=100)  # before the gallery takes one
    app.connect("autodoc-process-docstring", _drop_guide_links)
    app.connect("autodoc-process-docstring", _link_citations)
    app.connect("source-read", _link_citations_of_page)
