"""Tests on the Pythons and the versions of dependencies that pyproject.toml allows: `nox`.

`nox -s tests` takes the newest dependencies, `nox -s oldest` those of the lower bounds; a Python
that is not installed is skipped. `nox -s docs` builds the documentation, `nox -s links` follows its
links.
"""

import re
import tomllib
from pathlib import Path

import nox

PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
OLDEST_PYTHON = PYTHONS[0]
ALL = ("-m", "slow or not slow")  # tests

nox.options.sessions = ["tests", "oldest"]
nox.options.default_venv_backend = "uv|virtualenv"
nox.options.error_on_missing_interpreters = False


def lower_bounds(project, extras):
    """Return what pins each dependency to the oldest version that a project allows.

    Parameters
    ----------
    project : dict
        The table `project` of pyproject.toml.
    extras : sequence of str
        Whose dependencies count too.
    """
    optional, wanted = project["optional-dependencies"], list(project["dependencies"])
    waiting = list(extras)
    while waiting:
        for requirement in optional[waiting.pop()]:
            own = re.fullmatch(r"skhyst\[(.+)\]", requirement)
            if own:
                waiting += own[1].split(",")
            else:
                wanted.append(requirement)
    return sorted({requirement.replace(">=", "==") for requirement in wanted})


@nox.session(python=PYTHONS)
def tests(session):
    """Run the tests on the newest dependencies."""
    session.install("-e", ".[test]")
    session.run("python", "-m", "pytest", *ALL, *session.posargs)


@nox.session(python=OLDEST_PYTHON)
def oldest(session):
    """Run the tests on the oldest dependencies."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    session.install(*lower_bounds(project, ["test"]))
    session.install("--no-deps", "-e", ".")
    session.run("python", "-m", "pytest", *ALL, *session.posargs)


@nox.session
def docs(session):
    """Build the documentation, without a warning."""
    session.install("-e", ".[docs]")
    session.run("sphinx-build", "-W", "--keep-going", "-q", "docs", "docs/_build/html")
    session.run("python", "docs/check_pages.py", "docs/_build/html")


@nox.session
def links(session):
    """Follow the links of the documentation to other sites."""
    session.install("-e", ".[docs]")
    session.run(
        "sphinx-build", "-b", "linkcheck", "-D", "plot_gallery=0", "docs", "docs/_build/links"
    )
