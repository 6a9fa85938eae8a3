"""The checker of built pages finds what it looks for."""

import subprocess
import sys

import check_pages
import pytest

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
