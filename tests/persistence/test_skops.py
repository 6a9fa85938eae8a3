"""Models in skops files of this and of other versions."""

import sys
import tracemalloc
import warnings
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest
from sklearn.ensemble import RandomForestRegressor, StackingRegressor
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV
from sklearn.preprocessing import FunctionTransformer

from skhyst.compose import Cascade
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain
from skhyst.metrics import nrmse
from skhyst.model_selection import BlockedTimeSeriesSplit, washout_scorer
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
    with pytest.raises(ValueError, match=r"by skhyst 0\.0\.1, is broken, or cannot be read"):
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


def test_what_will_be_refused_is_told_on_saving(tmp_path):
    path = tmp_path / "model.skops"
    for model, kinds in (
        (RandomForestRegressor(2), "sklearn.tree._tree.Tree"),
        (StackingRegressor([("a", Ridge()), ("b", Gain())], cv=2), "sklearn.utils._bunch.Bunch"),
    ):
        model.fit(U, U[:, 0])
        with pytest.warns(UserWarning, match=rf"model\.skops holds {kinds}.*trust=True"):
            save_model(model, path)
        with pytest.raises(ValueError, match=kinds):
            load_model(path)
        np.testing.assert_array_equal(load_model(path, trust=True).predict(U), model.predict(U))


def test_own_metrics_are_trusted_and_other_functions_are_not(tmp_path):
    path, grid = tmp_path / "search.skops", {"dt": [1.0]}
    scorer = washout_scorer(nrmse, washout=2)
    search = GridSearchCV(Gain(), grid, scoring=scorer, cv=BlockedTimeSeriesSplit(2)).fit(
        U, U[:, 0]
    )
    save_model(search, path)
    assert load_model(path).best_score_ == search.best_score_
    for function in (save_model, load_model):  # a file must not make predict write or read one
        called = FunctionTransformer(function).fit(U)
        with pytest.warns(UserWarning, match=rf"skhyst\..*\.{function.__name__}"):
            save_model(called, path)
        with pytest.raises(ValueError, match=rf"\.{function.__name__}, which may run code"):
            load_model(path)


def rewritten(path, old, new):
    """Replace some bytes in each entry of a file, in the place of the file."""
    with ZipFile(path) as file:
        content = {name: file.read(name) for name in file.namelist()}
    assert any(old in data for data in content.values())
    with ZipFile(path, "w", ZIP_DEFLATED) as file:
        for name, data in content.items():
            file.writestr(name, data.replace(old, new))


@pytest.mark.parametrize("name", ["module_of_an_attacker", "antigravity", "this"])
def test_no_module_is_imported_that_a_file_names(tmp_path, monkeypatch, name):
    (tmp_path / "module_of_an_attacker.py").write_text("raise SystemExit('imported')")
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "gain.skops"
    save_model(Gain().fit(U, 2.0 * U[:, 0]), path)
    rewritten(path, b"skhyst.linear._gain", name.encode())
    with pytest.raises(ValueError, match=rf"{name}\.GainOperator, which may run code"):
        load_model(path)
    assert name not in sys.modules


def test_sizes_are_checked_before_memory_is_taken(tmp_path):
    path = tmp_path / "gain.skops"
    save_model(Gain().fit(U, 2.0 * U[:, 0]), path)
    with ZipFile(path, "a", ZIP_DEFLATED, compresslevel=1) as f, f.open("more.bin", "w") as entry:
        for _ in range(26):
            entry.write(bytes(10**7))
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"declares 26\d{7} bytes"):
        load_model(path)
    assert tracemalloc.get_traced_memory()[1] < 1e7
    tracemalloc.stop()


def test_an_array_larger_than_the_file_is_refused(tmp_path):
    path = tmp_path / "ridge.skops"
    save_model(Ridge().fit(U, U[:, 0]), path)
    rewritten(path, b"'shape': (1,), }                ", b"'shape': (30000000000,), }      ")
    with pytest.raises(ValueError, match="30000000000"):
        load_model(path)


def test_values_that_no_fit_finds_are_refused(tmp_path):
    """skops sets the fields of an object without its constructor."""
    u = np.sin(np.arange(50.0))
    data = u[:, None], FirstOrderLagOperator(0.3).run(u, 0.1)[0]
    lag, path = FirstOrderLag(dt=0.1).fit(*data), tmp_path / "model.skops"
    model = Cascade([("lag", FirstOrderLag())], dt=0.1).fit(*data)
    for own, part in ((lag, lag.operator_), (model, model.operator_.stages[0])):
        object.__setattr__(part, "time_constant", -0.3)
        save_model(own, path)
        with pytest.raises(ValueError, match="'time_constant' parameter of FirstOrderLagOperator"):
            load_model(path)


def test_parts_that_no_fit_has_made_are_refused(tmp_path):
    path = tmp_path / "model.skops"
    for attribute, value in (("operator_", FirstOrderLagOperator(0.3)), ("params_", {"gain": 1.0})):
        model = Gain().fit(U, 2.0 * U[:, 0])
        setattr(model, attribute, value)
        save_model(model, path)
        with pytest.raises(ValueError, match=f"'{attribute}' of Gain must"):
            load_model(path)
    model = Gain().fit(U, 2.0 * U[:, 0])
    object.__setattr__(model.records_[0], "n_samples", -1)
    save_model(model, path)
    with pytest.raises(ValueError, match="'n_samples' parameter of RecordSlice"):
        load_model(path)
    resampled = Gain(dt=1.0).fit(U, 2.0 * U[:, 0]).resampled(2.0)
    save_model(resampled, path)
    assert load_model(path).dt_ == 2.0
