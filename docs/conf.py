"""How Sphinx builds the site: ``python -m sphinx -W -n -b html docs docs/_build``, with the extra ``docs``."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from pkgutil import resolve_name

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

project = "dpend"
release = re.findall(r'^__version__ = "(.*)"$', (ROOT / "dpend/__init__.py").read_text(), flags=re.MULTILINE)[0]
author = "the dpend authors"
project_copyright = f"the dpend authors, MIT licence; version {release}"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # equations need no foreign host
    "sphinx_copybutton",
    "sphinx_design",
    "matplotlib.sphinxext.plot_directive",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "study_directive",
]
# Of the results only pictures, films and tables are read; arrays and jobs stay where they are.
exclude_patterns = ["_build", "figures"]
nitpicky = True
nitpick_ignore_regex = [
    # The libraries' own pages would have to be fetched to link to them, and a build needs no network.
    ("py:class", r"(numpy|collections)\..*"),
]

myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

autosummary_generate = False
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "none"  # numpydoc's sections say types in words, with shapes and units
autodoc_class_signature = "mixed"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

# -D plot_gallery=0 builds without running the scripts, as the tests do, which run them by themselves.
sphinx_gallery_conf = {
    "examples_dirs": ["../examples/gallery", "../examples/labs"],
    "gallery_dirs": ["gallery", "labs"],
    "filename_pattern": r"/(plot|lab)_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "capture_repr": (),
    "image_srcset": ["2x"],
    "thumbnail_size": (400, 260),
    "show_signature": False,
    "write_computation_times": False,  # a page that asks three other hosts for its table
    "first_notebook_cell": "# Needs dpend: pip install -e . in a checkout of its repository.\n%matplotlib inline",
}

plot_formats = [("svg", 100)]
plot_html_show_formats = False
plot_html_show_source_link = False
plot_working_directory = str(ROOT)
plot_rcparams = {"axes.spines.right": False, "axes.spines.top": False, "legend.frameon": False}
plot_apply_rcparams = True

html_theme = "pydata_sphinx_theme"
html_title = f"dpend {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_favicon = "_static/logo.svg"
html_show_sourcelink = False
html_copy_source = False
html_context = {"default_mode": "auto"}
html_sidebars = {"index": [], "start": [], "report": []}
html_theme_options = {
    "logo": {"text": "dpend", "image_light": "_static/logo.svg", "image_dark": "_static/logo-dark.svg"},
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "search_as_you_type": True,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
copybutton_exclude = ".linenos, .gp, .go"

OUTSIDE = {
    "contributing": ROOT / "CONTRIBUTING.md",
    "changes": ROOT / "CHANGELOG.md",
    "benchmarks": ROOT / "benchmarks/README.md",
    "security": ROOT / "SECURITY.md",
    "support": ROOT / "SUPPORT.md",
    "roadmap": ROOT / "ROADMAP.md",
    "code-of-conduct": ROOT / "CODE_OF_CONDUCT.md",
}
"""Pages whose text stands elsewhere in the repository, where people look for it."""

MADE = {
    ROOT / "examples/gallery": ROOT / "docs/gallery/index.rst",
    ROOT / "examples/labs": ROOT / "docs/labs/index.rst",
}
"""Folders that pages link to, and what is made of them."""


def read_source(app: Sphinx, docname: str, source: list[str]) -> None:
    """Take a page's text from where it stands, and let links between the two places hold in both."""
    page = OUTSIDE.get(docname)
    if page is not None:
        app.env.note_dependency(str(page))
        source[0] = page.read_text(encoding="utf-8")
    folder = (page or Path(app.env.doc2path(docname))).parent
    here = Path(app.env.doc2path(docname)).parent
    pages = {path.resolve(): ROOT / "docs" / f"{name}.md" for name, path in OUTSIDE.items()}

    def moved(match: re.Match[str]) -> str:
        target = (folder / match["path"]).resolve()
        if "://" in match["path"] or not target.exists():
            return match[0]
        place = (pages | MADE).get(target, target)
        if place.parent in MADE:  # a script, whose page is beside the index
            place = MADE[place.parent].with_name(f"{place.stem}.rst")
        if not place.is_relative_to(ROOT / "docs"):
            return f"](path:{os.path.relpath(place, here)})"  # no page: the file itself
        return f"]({os.path.relpath(place, here)}{match['anchor'] or ''})"

    source[0] = re.sub(r"\]\((?P<path>[^)#\s]+)(?P<anchor>#[^)\s]*)?\)", moved, source[0])


def complete(_app: Sphinx, what: str, _name: str, member: object, _options: object, lines: list[str]) -> None:
    """Document a method that implements a protocol's with what the protocol says of it."""
    from protocols import completed  # which stands in this folder, not yet on the path above

    if what == "method" and callable(member):
        lines[:] = completed(member).splitlines()


def skip_member(_app: Sphinx, _what: str, _name: str, member: object, _skip: bool, _options: object) -> bool | None:
    """Pass over what a NamedTuple says of its fields by itself, which is only their number."""
    return True if (getattr(member, "__doc__", None) or "").startswith("Alias for field number") else None


def text_of_inner_name(
    _app: Sphinx, _env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.TextElement | None:
    """Let a name that exists but is not in the reference stand as text; one that does not exist stays a warning."""
    target = node.get("reftarget", "")
    if node.get("refdomain") != "py" or target.partition(".")[0] not in ("dpend", "controllers", "rl", "studies"):
        return None
    try:
        resolve_name(target)
    except (ImportError, AttributeError):
        return None
    return content


def write_playground(app: Sphinx, error: Exception | None) -> None:
    """Write the page that needs no server beside the site, where the page about it embeds it."""
    if error is None and app.builder.name == "html":
        from studies.playground.export import export

        export(Path(app.outdir) / "playground")


def setup(app: Sphinx) -> None:
    """Register what this file adds to Sphinx."""
    app.connect("missing-reference", text_of_inner_name)
    app.connect("source-read", read_source)
    app.connect("autodoc-skip-member", skip_member)
    app.connect("autodoc-process-docstring", complete, priority=400)  # before numpydoc
    app.connect("build-finished", write_playground)
