"""Models in skops files of this and of other versions."""

import warnings
from zipfile import ZipFile

import numpy as np
import pytest
from sklearn.linear_model import Ridge

from skhyst.linear import Gain
from skhyst.persistence import _skops, load_model, save_model

U = np.linspace(0.0, 1.0, 20)[:, None]


@pytest.fixture(autouse=True)
def skops():
    pytest.importorskip("skops.io")  # its import takes half a second


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Give a function that saves a gain as another version would, and returns model and file."""

    def save(by):
        model, path = Gain().fit(U, 2.0 * U[:, 0]), tmp_path / "gain.skops"
        with monkeypatch.context() as patch:
            patch.setattr(_skops, "_VERSION", by)
            save_model(model, path)
        return model, path

    return save


def test_a_file_of_an_earlier_version_is_read_with_a_warning(written):
    model, path = written("0.0.1")
    with pytest.warns(UserWarning, match=r"gain\.skops was written by skhyst 0\.0\.1, this is"):
        again = load_model(path)
    np.testing.assert_array_equal(again.predict(U), model.predict(U))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_model(written(_skops._VERSION)[1])


def test_a_file_that_cannot_be_read_any_more_says_who_has_written_it(written, monkeypatch):
    _, path = written("0.0.1")

    def gone(*args):
        raise AttributeError("no class Amplifier")

    monkeypatch.setattr(_skops, "_load_skops", gone)
    with pytest.raises(ValueError, match=r"written by skhyst 0\.0\.1, is broken, or nothing"):
        load_model(path)


def test_a_file_without_a_version_is_read(tmp_path):
    import skops.io

    skops.io.dump(Ridge().fit(U, U[:, 0]), tmp_path / "ridge.skops")
    np.testing.assert_allclose(load_model(tmp_path / "ridge.skops").predict([[0.5]]), 0.5, atol=0.1)


def test_a_class_may_be_named_by_the_package_that_exports_it(tmp_path):
    """As files of a version name it in which the package was one module."""
    model, path, earlier = Gain().fit(U, 2.0 * U[:, 0]), tmp_path / "new", tmp_path / "old.skops"
    save_model(model, path.with_suffix(".skops"))
    with ZipFile(path.with_suffix(".skops")) as new, ZipFile(earlier, "w") as old:
        for name in new.namelist():
            content = new.read(name)
            old.writestr(name, content.replace(b"skhyst.linear._gain", b"skhyst.linear"))
    assert b"skhyst.linear._gain" not in earlier.read_bytes()
    np.testing.assert_array_equal(load_model(earlier).predict(U), model.predict(U))
