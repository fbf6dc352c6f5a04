"""The documentation site: `make docs` builds it, warnings are errors (CONTRIBUTING.md)."""

from __future__ import annotations

import shutil
import sys
from importlib import import_module
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

from figures import FigureScraper  # noqa: E402

import clradar  # noqa: E402

project = "clradar"
author = "The clradar founders"
copyright = author
release = version = clradar.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
    "public_names",
    "command_line",
]
exclude_patterns = ["extensions", "tutorials/*.ipynb", "tutorials/*.py", "tutorials/*.zip"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

# Single backticks of docstrings: a link where the name has a page, else code.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
# One entry for parameters or attributes that are described together.
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style"), ("Warns", "params_style")]

public_packages = (HERE / "api" / "index.md").read_text().split("```")[1].split()[3:]
for package in map(import_module, public_packages):
    for public_name in package.__all__:  # now: pydantic's records cannot be imported by autodoc
        getattr(package, public_name)

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

# Executed beside copies of themselves: what they write stays out of the source tree. The files are
# copied with their times, and only those that changed run again.
TUTORIALS = HERE.parent / "build" / "tutorials"
shutil.rmtree(TUTORIALS, ignore_errors=True)
shutil.copytree(
    HERE.parent / "examples" / "tutorials",
    TUTORIALS,
    ignore=shutil.ignore_patterns("__pycache__"),
)
# Pages of tutorials that have another name now.
for page in (HERE / "tutorials").glob("*.rst"):
    if page.stem != "index" and not (TUTORIALS / f"{page.stem}.py").exists():
        page.unlink()
sphinx_gallery_conf = {
    "examples_dirs": str(TUTORIALS),
    "gallery_dirs": "tutorials",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "figures.ByNumber",
    "image_scrapers": (FigureScraper(),),
    "capture_repr": (),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
    # That of the machine which built the site says nothing to a reader.
    "min_reported_time": 10**6,
    "remove_config_comments": True,
}

html_theme = "furo"
html_static_path, html_css_files = ["static"], ["code.css"]
html_title = f"clradar {release}"
html_show_sphinx = False
html_copy_source = False
html_use_index = False
