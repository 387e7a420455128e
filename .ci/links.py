"""Check that every link between the pages of a folder leads to one of them: ``links.py FOLDER``."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from urllib.parse import unquote


def main(folder: Path) -> None:
    """Stop where a link leads nowhere."""
    pages = {page: page.read_text(encoding="utf-8") for page in folder.resolve().rglob("*.html")}
    ids = {page: set(re.findall(r'\bid="([^"]+)"', text)) for page, text in pages.items()}
    lost = []
    for page, text in pages.items():
        for link in re.findall(r'<a [^>]*href="([^"]+)"', text):
            if re.match(r"[a-z]+:", link) or "${" in link:  # elsewhere, or made by pdoc's own script
                continue
            name, _, part = unquote(link).partition("#")
            target = (page.parent / name).resolve() if name else page
            # pdoc names the private base of a class, and the beginning of an abstract one, but shows neither
            hidden = any(step.startswith("_") for step in part.split("."))
            if not target.is_file() or (part and target in pages and not hidden and part not in ids[target]):
                lost.append(f"  {page.name}: {link}")
    if lost:
        sys.exit("\n".join([f"{len(lost)} links lead nowhere", *lost[:20]]))
    print(f"{len(pages)} pages, every link leads to one")


main(Path(sys.argv[1]))
