"""Docstrings of public names are checked as they are shown, with those that a base gives."""

import sys
from types import ModuleType

import pytest

pytest.importorskip("numpydoc", reason="the check uses it")
docstrings = pytest.importorskip("docstrings")


class Base:
    """A base."""

    def predict(self, X):
        """Return a response.

        Parameters
        ----------
        X : ndarray of shape (n_samples, n_inputs)
            Drive.

        Returns
        -------
        ndarray of shape (n_samples,)
            Response.
        """


class Sound(Base):
    """A class.

    Attributes
    ----------
    state : float
        Documented here.
    """

    def predict(self, X):
        return X

    @property
    def state(self):
        return 0.0


class Broken(Base):
    """A class.

    Parameters
    ----------
    size : int
        It has no such parameter.
    """

    def predict(self, Y):
        return Y

    def run(self, u):
        """Return a response."""
        return u


@pytest.fixture
def found(monkeypatch):
    """Return the checks that fail by name, of a package with a public module."""
    package, public = ModuleType("plant"), ModuleType("plant.models")
    package.__path__ = []
    for kind in (Base, Sound, Broken):
        monkeypatch.setattr(kind, "__module__", "plant.models")
        setattr(public, kind.__name__, kind)
    package.models, public.__all__ = public, ["Sound", "Broken"]
    for module in (package, public):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(docstrings, "public_modules", lambda package: ["plant.models"])
    faults = docstrings.faults(docstrings.public_names("plant"), {"ES01"})
    return {(name.removeprefix("plant.models."), check) for name, check, _ in faults}


def test_an_inherited_docstring_describes_a_method(found):
    assert not any(name.startswith("Sound") for name, _ in found)


def test_each_fault_is_found(found):
    assert found == {
        ("Broken", "EX01"),  # it has `run`: an operator is shown by an example
        ("Broken", "PR02"),
        ("Broken.predict", "PR01"),
        ("Broken.predict", "PR02"),
        ("Broken.run", "PR01"),
        ("Broken.run", "RT01"),
    }
