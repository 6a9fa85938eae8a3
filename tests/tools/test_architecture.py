"""The structure of the package, as `tools/architecture.py` measures it."""

import re

from architecture import LAYERS, ROOT, figures

FAULTS = {
    "operators/_loops.py": "from ..base import Model\n",  # upwards, and in a circle
    "base.py": "from .operators import _loops\nModel = 1\n",  # another package's
    "compose/_sum.py": "from .. import __version__, _jit\n",
    "compose/__init__.py": "from ._sum import Sum as Sum\n",
    "diagnosis/__init__.py": "from ._search import Search\n__all__ = ['Search']\n",
    "diagnosis/_search.py": "class Search:\n    pass\n",
}


def test_imports_run_one_way_and_keep_to_what_is_public():
    assert [str(figure) for figure in figures() if figure.value] == []


def test_each_fault_is_found(tmp_path):
    files = FAULTS | {f"{name}/__init__.py": "" for name in (".", "operators")}
    for name, text in files.items():
        path = tmp_path / "skhyst" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "examples").mkdir()
    (tmp_path / "examples" / "plot_it.py").write_text("from skhyst.compose import Sum\n")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_it.py").write_text("from skhyst.diagnosis._search import Search\n")
    found = {figure.name: figure.found for figure in figures(tmp_path)}
    assert found == {
        "circles of imports": ["skhyst.base <-> skhyst.operators._loops"],
        "imports of another package's private module": ["skhyst.base: skhyst.operators._loops"],
        "imports upwards through the layers": ["skhyst.operators._loops: skhyst.base"],
        "private imports in tests of what is public": [
            "tests.test_it: skhyst.diagnosis._search.Search, public in skhyst.diagnosis"
        ],
        "shared names that no other package uses": ["skhyst.compose.Sum"],
        "imports in examples of what is not public": ["examples.plot_it: skhyst.compose.Sum"],
    }


def test_the_picture_of_the_layers_shows_all_of_them():
    page = (ROOT / "docs" / "developers.rst").read_text(encoding="utf-8")
    picture = re.search(r"downwards::\n\n((?: {4}.*\n)+)", page)[1]
    drawn = [
        name for line in picture.splitlines() for name in re.split(" {3}", line[4:])[0].split()
    ]
    for layer in LAYERS:
        public = {name for name in layer if not name.startswith("_")}
        assert set(drawn[len(drawn) - len(public) :]) == public
        del drawn[len(drawn) - len(public) :]
    assert drawn == []
