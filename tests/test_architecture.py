"""The structure of the package, as `benchmarks/architecture.py` measures it."""

import pytest
from architecture import figures

KEPT = (
    "`isinstance` in skhyst.diagnosis",
    "circles of imports",
    "functions of complexity above 15",
    "functions of more than 60 lines",
    "imports of another package's private module",
    "imports upwards through the layers",
    "named numbers in skhyst.diagnosis, drawing aside",
    "private imports in tests of what is public",
)
FAULTS = {
    "operators/_loops.py": "from ..base import Model\n",  # upwards, and in a circle
    "base.py": "from .operators import _loops\nModel = 1\n",  # another package's
    "compose/_sum.py": "from .. import _jit\n\ndef add(x):\n" + 61 * "    x += 1\n",
    "diagnosis/__init__.py": "from ._search import Search\n__all__ = ['Search']\n",
    "diagnosis/_search.py": """
_FEW, _MANY = 1, 2
NAMES = ("a", "b")

@jit(inline=True)
def loop(x):
    if x: return 1

class Search:
    def fit(self, x):
        'Not a line of the body.'
        return isinstance(x, int)

    def verdict(self, x):
"""
    + 15 * "        if x: return 1\n",
}


@pytest.fixture(scope="module")
def measured():
    return {figure.name: figure for figure in figures()}


@pytest.mark.parametrize("name", KEPT)
def test_bars_are_kept(name, measured):
    assert measured[name].value <= measured[name].bar, str(measured[name])


def test_each_fault_is_found(tmp_path):
    files = FAULTS | {f"{name}/__init__.py": "" for name in (".", "operators", "compose")}
    for name, text in files.items():
        path = tmp_path / "skhyst" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_it.py").write_text("from skhyst.diagnosis._search import Search\n")
    found = {figure.name: figure.found for figure in figures(tmp_path)}
    search = "skhyst.diagnosis._search"
    assert found["circles of imports"] == ["skhyst.base <-> skhyst.operators._loops"]
    assert found["imports of another package's private module"] == [
        "skhyst.base: skhyst.operators._loops"
    ]
    assert found["imports upwards through the layers"] == ["skhyst.operators._loops: skhyst.base"]
    assert found["functions of more than 60 lines"] == ["skhyst.compose._sum.add: 61 lines"]
    assert found["functions of complexity above 15"] == [f"{search}.Search.verdict: 16"]
    assert found["`isinstance` in skhyst.diagnosis"] == [f"{search}: line 12"]
    numbers = found["named numbers in skhyst.diagnosis, drawing aside"]
    assert numbers == [f"{search}._FEW", f"{search}._MANY"]
    assert found["private imports in tests of what is public"] == [
        f"tests.test_it: {search}.Search, public in skhyst.diagnosis"
    ]
