"""Every citation leads to an entry of the bibliography, and every entry is cited."""

import ast
import re
from pathlib import Path

import pytest
from citations import Reference, add_keys, read_references

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
REFERENCES = read_references()
CITED = re.compile(r"\*([^*]+)\*, (\d{4}|undated)\b")
NAMED_AGAIN = re.compile(r"(?<=[a-zé.íč]) \(?((?:1[89]|20)\d\d|undated)(?=[),;])")
OLD_WAY = re.compile(r"\"[A-Z][^\"]{15,}\"[^\"]{0,60}\b(?:19|20)\d\d\b")
INNER_NAMES = re.compile(
    r"(?:tanh|gray.box|inchworm|LuGre|NARMAX\S*) paper|list of errata", re.IGNORECASE
)


def one_line(text):
    """Return a text without the breaks of its lines and the signs of comments."""
    return re.sub(r"\s+(?:# )?", " ", text)


def docstrings(path):
    """Return the docstrings and whole-line comments of a file, without examples."""
    text = path.read_text(encoding="utf-8")
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, kinds)]
    found = [ast.get_docstring(node).split(">>>")[0] for node in nodes if ast.get_docstring(node)]
    return found + re.findall(r"(?:^ *# .*\n)+", text, re.MULTILINE)


def texts():
    """Return all that is said to a reader, one line a text."""
    found = []
    for folder in ("skhyst", "examples", "benchmarks", "tools", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            found += [(path, one_line(text)) for text in docstrings(path)]
    pages = [*(ROOT / "docs").glob("*.rst"), *(ROOT / "docs").glob("user_guide/**/*.rst")]
    pages += [*(ROOT / "examples").rglob("*.rst"), ROOT / "README.md", ROOT / "CHANGELOG.md"]
    return found + [(path, one_line(path.read_text(encoding="utf-8"))) for path in pages]


@pytest.fixture(scope="module")
def said():
    return [(path, text) for path, text in texts() if path != Path(__file__)]


def unknown(said, pattern, is_known):
    return [
        f"{path.relative_to(ROOT)}: {text[max(0, match.start() - 60) : match.end()]}"
        for path, text in said
        for match in pattern.finditer(text)
        if not is_known(text, match)
    ]


def test_citations_have_entries(said):
    def is_known(text, match):
        before, (container, year) = text[: match.start()], match.groups()
        return any(
            (r.container, r.year) == (container, year) and before.endswith(f"{r.authors}, ")
            for r in REFERENCES.values()
        )

    assert unknown(said, CITED, is_known) == []


def test_works_that_are_named_again_have_entries(said):
    def is_known(text, match):
        before, year = text[: match.start()], match[1]
        return any(r.year == year and before.endswith(r.authors) for r in REFERENCES.values())

    assert unknown(said, NAMED_AGAIN, is_known) == []


def test_entries_are_cited(said):
    everything = " ".join(text for _, text in said)
    assert [key for key, r in REFERENCES.items() if r.citation not in everything] == []


def test_there_is_one_way_to_cite(said):
    assert unknown(said, OLD_WAY, lambda text, match: False) == []
    assert unknown(said, INNER_NAMES, lambda text, match: False) == []


def test_entries_are_complete():
    text = (ROOT / "docs/references.bib").read_text(encoding="utf-8")
    assert len(REFERENCES) == text.count("\n@") >= 100
    assert list(REFERENCES) == sorted(REFERENCES)
    assert len({r.citation for r in REFERENCES.values()}) == len(REFERENCES)
    for body in text.split("\n@")[1:]:
        assert {"author", "title", "year"} <= set(re.findall(r"^  (\w+) = \{", body, re.MULTILINE))


def test_citations_of_a_bibliography(tmp_path):
    entries = """@article{one,
  author = {{Van Loan}, C. and Wen, Y.-K.},
  title = {{A: b}},
  journal = {The Journal},
  year = {1978},
}

@book{two,
  author = {A, B. and C, D. and E, F. and G, H.},
  title = {Curves: An Introduction},
  year = {2001},
}
"""
    (tmp_path / "x.bib").write_text(entries)
    found = read_references(tmp_path / "x.bib")
    assert found["one"] == Reference("one", "Van Loan and Wen", "The Journal", "1978")
    assert found["two"].citation == "A et al., *Curves*, 2001"
    keyed = add_keys("See Van Loan and\n    Wen, *The Journal*, 1978, (3).", found)
    assert keyed == "See Van Loan and\n    Wen, *The Journal*, 1978 :cite:`one`, (3)."
