"""What the project says of itself in several places is the same."""

import re
import tomllib
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace

import pytest
from sklearn.utils.fixes import parse_version

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = [
    text.rpartition(" ")[2]
    for text in PROJECT["classifiers"]
    if re.search(r"Python :: 3\.\d+$", text)
]


def test_all_name_the_same_pythons():
    nox = (ROOT / "noxfile.py").read_text(encoding="utf-8")
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    for text in (
        re.search(r"PYTHONS = \[(.*)\]", nox)[1],
        re.search(r"\n +python: \[(.*)\]", workflow)[1],
    ):
        assert re.findall(r'"(3\.\d+)"', text) == PYTHONS
    assert PROJECT["requires-python"] == f">={PYTHONS[0]}"


def test_the_recipe_of_conda_needs_what_the_project_needs():
    recipe = (ROOT / ".conda" / "recipe.yaml").read_text(encoding="utf-8")
    run = re.search(r"\n  run:\n((?:    - .*\n)+)", recipe)[1]
    needed = {line.replace(" ", "") for line in re.findall(r"- (.*)", run)[1:]}
    assert needed == set(PROJECT["dependencies"])
    assert PROJECT["version"].startswith(re.search(r"\n  version: (\S+)", recipe)[1])


def test_the_citation_is_of_this_version():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {PROJECT['version']}\n" in citation
    assert f"\nlicense: {PROJECT['license']}\n" in citation


def test_no_dependency_has_an_upper_bound_and_each_has_a_lower_one():
    for requirement in sum(PROJECT["optional-dependencies"].values(), PROJECT["dependencies"]):
        if not requirement.startswith("skhyst["):
            assert re.fullmatch(r"[\w.-]+>=[\d.]+", requirement), requirement


def test_the_oldest_versions_are_the_lower_bounds():
    pytest.importorskip("nox")
    pins = run_path(str(ROOT / "noxfile.py"))["lower_bounds"](PROJECT, ["test"])
    assert not any(">" in pin or "skhyst" in pin for pin in pins)
    assert set(PROJECT["dependencies"]) <= {pin.replace("==", ">=") for pin in pins}
    assert any(pin.startswith("matplotlib==") for pin in pins)  # of an extra in an extra
    assert all(parse_version(pin.partition("==")[2]) > parse_version("0") for pin in pins)


@pytest.mark.parametrize(
    ("asked", "given", "run"),
    [
        ("not slow", ["tests"], "not slow"),
        ("not slow", ["tests", "tests/test_project.py::test_it"], ""),
        ("slow", ["tests/test_project.py::TestIt::test_it[a]"], "slow"),
    ],
)
def test_what_is_named_by_its_id_is_run_though_it_is_slow(request, asked, given, run):
    plugins = {getattr(p, "__file__", ""): p for p in request.config.pluginmanager.get_plugins()}
    options = SimpleNamespace(markexpr=asked)
    config = SimpleNamespace(args=given, option=options, addinivalue_line=lambda *line: None)
    plugins[str(ROOT / "tests" / "conftest.py")].pytest_configure(config)
    assert options.markexpr == run
