"""Check built pages: `python docs/check_pages.py docs/_build/html`.

They must need no network when they are read, have no broken link, and show no equation as LaTeX
source. Prints one line per fault, and fails if there is any.
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

__all__ = ["faults"]

_FETCHED = {  # what a browser loads by itself, by tag and attribute
    **dict.fromkeys(["script", "img", "iframe", "source", "embed", "audio", "video"], "src"),
    **{"link": "href", "object": "data", "use": "href"},
}
_NOT_FETCHED = {"next", "prev", "index", "search", "canonical", "author", "copyright", "license"}
_IN_STYLE = re.compile(r"""(?:url\(\s*|@import\s+)["']?((?:https?:)?//[^"')\s]+)""")
_TYPED = re.compile(r"\\[(\[]|\\(?:frac|sum|dot|begin|mathrm)\b")
_VERBATIM = {"pre", "code", "script", "style", "annotation"}


class _Page(HTMLParser):
    """What a page fetches, its links, its anchors, and LaTeX source in its visible text."""

    def __init__(self, text):
        super().__init__()
        self.fetched, self.links, self.anchors, self.typed = [], [], set(), []
        self._verbatim = 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self._verbatim += tag in _VERBATIM
        self.anchors |= {attrs[key] for key in ("id", "name") if attrs.get(key)}
        target = attrs.get(_FETCHED.get(tag))
        if target and not (tag == "link" and attrs.get("rel") in _NOT_FETCHED):
            self.fetched.append(target)
        if tag == "a" and attrs.get("href"):
            self.links.append(attrs["href"])
        self.fetched += _IN_STYLE.findall(attrs.get("style") or "")

    def handle_endtag(self, tag):
        self._verbatim -= tag in _VERBATIM

    def handle_data(self, data):
        if not self._verbatim:
            self.typed += _TYPED.findall(data)
        elif self.cdata_elem == "style":
            self.fetched += _IN_STYLE.findall(data)


def _is_elsewhere(target):
    parts = urlsplit(target)
    return bool(parts.netloc) or parts.scheme in ("http", "https")


def faults(folder):
    """Find the faults of the pages in a folder.

    Parameters
    ----------
    folder : path-like
        Folder of the built pages, with all files that they need.

    Returns
    -------
    list of str
        One line per fault; empty if there is none.
    """
    folder = Path(folder).resolve()
    pages = {
        path: _Page(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("*.html"))
        if "_static" not in path.parts  # templates of the theme
    }
    found = [] if pages else [f"{folder} has no pages"]
    for path, page in pages.items():
        name = path.relative_to(folder)
        for target in page.fetched + page.links:
            fetched = target in page.fetched
            if _is_elsewhere(target):
                found += [f"{name} fetches {target}"] if fetched else []
            elif not _leads_somewhere(target, path, pages):
                found.append(f"{name} leads to {target}, which is not there")
        found += [f"{name} shows {typed!r} of an equation" for typed in sorted(set(page.typed))]
    for path in sorted(folder.rglob("*.css")):
        for target in _IN_STYLE.findall(path.read_text(encoding="utf-8")):
            found.append(f"{path.relative_to(folder)} fetches {target}")
    return found


def _leads_somewhere(target, path, pages):
    parts = urlsplit(target)
    if parts.scheme:  # data: and mailto:
        return True
    goal = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not parts.fragment or goal not in pages:
        return goal.exists()
    return unquote(parts.fragment) in pages[goal].anchors


def main():
    found = [fault for folder in sys.argv[1:] for fault in faults(folder)]
    print(*found or ["The pages need no network and no page that is not there."], sep="\n")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
