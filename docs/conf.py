"""How Sphinx builds the site from these pages: `make docs`. The site has the folders of the repository."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import fame

project = "FAME"
version = release = fame.__version__
html_title = f"FAME {version}"
extensions = ["myst_parser", "site_pages"]
root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "SECURITY.md",
    "examples/README.md",
    "examples/cookbook/*/README.md",
    "tests/models/README.md",
]
exclude_patterns = [".*", "out", "build", "dist", "benchmarks", "fame", "models", "robots", "sim2d"]
myst_heading_anchors = 4
myst_url_schemes = {"http": None, "https": None, "repository": "{{path}}#{{fragment}}"}
html_theme = "furo"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_show_search_summary = False  # summaries are fetched, which a browser refuses for files
