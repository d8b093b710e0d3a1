"""Pages of the repository's root, such as README.md, as pages of the site that `nox -s docs` builds."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "samples/README.md")
_LINK = re.compile(r"(\]\()([^)\s:#]+)([^)]*\))")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that lie outside of docs/, and the files that they show."""
    from mkdocs.structure.files import File

    for page in PAGES:
        files.append(File.generated(config, page, content=(ROOT / page).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """In the repository links lead from file to file; in the site docs/ is the root."""
    here = page.file.src_uri
    place = posixpath.dirname(here if here in PAGES else f"docs/{here}")
    start = posixpath.dirname(here)

    def moved(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(place, link[2]))
        if not (target.startswith("docs/") or target in PAGES):
            return link[0]
        return f"{link[1]}{posixpath.relpath(target.removeprefix('docs/'), start or '.')}{link[3]}"

    return _LINK.sub(moved, markdown)
