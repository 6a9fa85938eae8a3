"""Pages lead to each other, their code runs, and the checker of built pages finds its faults."""

import doctest
import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import check_pages
import numpy as np
import pytest
import recordings

import skhyst
from skhyst import operators
from skhyst.diagnosis import effect_names

DOCS = Path(__file__).parents[1] / "docs"
COMMANDS = {"cli"}  # the user guide has them
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
PAGE = '<html><body id="top"><h1>Title</h1>{}</body></html>'


@pytest.fixture
def pages(tmp_path):
    """Return the faults of a folder with a sound page, `other.html`, and one with this body."""
    (tmp_path / "other.html").write_text(PAGE.format('<p id="here"><a href="index.html">back</a>'))

    def build(body):
        (tmp_path / "index.html").write_text(PAGE.format(body), encoding="utf-8")
        return check_pages.faults(tmp_path)

    return build


@pytest.mark.parametrize(
    "body",
    [
        '<a href="other.html#here">there</a> <a href="#top">up</a> <a href="https://a.org">out</a>',
        '<img src="data:image/png;base64,AA"><link rel="canonical" href="https://a.org">',
        r"<pre>\(a\)</pre><math><annotation>\frac{1}{2}</annotation></math>",
    ],
)
def test_sound_pages_pass(pages, body):
    assert pages(body) == []


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ('<script src="https://a.org/b.js"></script>', "index.html fetches https://a.org/b.js"),
        ('<script src="//a.org/b.js"></script>', "index.html fetches //a.org/b.js"),
        ('<link rel="stylesheet" href="http://a.org/b.css">', "index.html fetches http://a.org"),
        ("<style>@import 'https://a.org/b.css';</style>", "index.html fetches https://a.org"),
        ('<p style="background: url(https://a.org/b.png)">', "index.html fetches https://a.org"),
        ('<a href="nowhere.html">x</a>', "index.html leads to nowhere.html"),
        ('<img src="nothing.png">', "index.html leads to nothing.png"),
        ('<a href="other.html#gone">x</a>', "index.html leads to other.html#gone"),
        (r"<p>\(a = b\)</p>", r"index.html shows"),
    ],
)
def test_faults_are_found(pages, body, fault):
    found = pages(body)
    assert len(found) == 1
    assert found[0].startswith(fault)


def test_style_sheets_are_read(pages, tmp_path):
    (tmp_path / "a.css").write_text("@font-face { src: url(https://a.org/f.woff2) }")
    assert pages("") == ["a.css fetches https://a.org/f.woff2"]


def test_command_fails_where_there_are_no_pages(tmp_path):
    command = [sys.executable, check_pages.__file__, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "has no pages" in done.stdout


def in_toctrees(name):
    """Return the pages below a page in the tables of contents, itself included."""
    text = (DOCS / f"{name}.rst").read_text(encoding="utf-8")
    found = {name}
    for block in re.findall(r"\.\. toctree::\n((?: +.*\n|\n)+)", text):
        for entry in re.findall(r"^ +([\w/]+)$", block, re.MULTILINE):
            path = Path(entry[1:]) if entry.startswith("/") else Path(name).parent / entry
            if not path.parts[0].startswith("auto_examples"):
                found |= in_toctrees(path.as_posix())
    return found


def test_every_page_is_in_a_table_of_contents():
    pages = {path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.rglob("*.rst")}
    built = ("_", "auto_examples", "api/generated", "sg_execution_times")
    assert in_toctrees("index") == {page for page in pages if not page.startswith(built)}


def test_each_effect_has_a_page_and_a_picture():
    overview = (DOCS / "howto" / "which_effect.rst").read_text(encoding="utf-8")
    for name in effect_names():
        page = (DOCS / "user_guide" / "effects" / f"{name}.rst").read_text(encoding="utf-8")
        assert f"/pictures/effects/{name}.svg" in page
        assert f"/pictures/effects/{name}.svg" in overview


def test_each_effect_shows_in_its_picture():
    pytest.importorskip("matplotlib", reason="the pictures are drawn with it")
    signatures = importlib.import_module("signatures")
    assert set(signatures.SIGNATURES) == set(effect_names())
    for name, signature in signatures.SIGNATURES.items():
        y, model = signature.responses()
        assert np.abs(y - model).max() > 8.0 * signatures.NOISE * np.ptp(y), name


def test_each_public_module_is_in_the_reference():
    text = (DOCS / "api" / "index.rst").read_text(encoding="utf-8")
    listed = set(re.findall(r"^   (skhyst\.\w+)$", text, re.MULTILINE))
    for module in pkgutil.iter_modules(skhyst.__path__, "skhyst."):
        name = module.name.rpartition(".")[2]
        if not name.startswith("_") and name not in COMMANDS:
            public = getattr(importlib.import_module(module.name), "__all__", ())
            assert module.name in listed or not public, module.name


def test_the_page_of_the_protocol_agrees_with_the_class():
    """Every member has a row, and is read by the module named there; functions are dispatched."""
    page = (DOCS / "developers.rst").read_text(encoding="utf-8")
    page = page.partition("These ten members")[2].partition("Members that a tree reads")[0]
    members, functions = (
        {name: row for row in table for name in re.findall(r"`(\w+)", row[:31])}
        for table in (
            re.split(r"\n(?=`)", part)[1:] for part in page.split("What a single concern")
        )
    )
    assert set(members) == {name for name in vars(operators.Operator) if name[0] != "_"}
    assert len(members) == 10
    for name, row in members.items():
        for path in re.findall(r"`([\w/]+\.py)`", row):
            source = (Path(skhyst.__file__).parent / path).read_text(encoding="utf-8")
            assert re.search(rf"\.{name}\b", source), (name, path)
        assert ".py`" in row
    for name in functions:
        assert len(getattr(operators, name).registry) > 1


@pytest.mark.parametrize(
    "page",
    [
        "understand/play",
        *(f"howto/{name}" for name in ("closed_loop", "compare_models", "data", "deploy")),
        *(f"howto/{name}" for name in ("several_records", "single_sine")),
    ],
)
def test_code_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = str(DOCS / f"{page}.rst")
    failed, tried = doctest.testfile(path, module_relative=False, optionflags=FLAGS)
    assert tried > 0
    assert failed == 0


@pytest.mark.slow
@pytest.mark.needs_recordings("silverbox", named=True)
def test_the_tutorial_is_told_as_it_is(monkeypatch):
    monkeypatch.chdir(recordings.SHARED)
    path = str(DOCS / "tutorial.rst")
    assert doctest.testfile(path, module_relative=False, optionflags=FLAGS).failed == 0
