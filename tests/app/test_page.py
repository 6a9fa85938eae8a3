"""The page of `skhyst app`, clicked through without a browser."""

import shlex
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import skhyst
from skhyst.app import suggest_model
from skhyst.app._suggestion import DEVICES
from skhyst.cli import main
from skhyst.discovery import parse_model

PAGE = Path(skhyst.__file__).with_name("app") / "_page.py"


@pytest.mark.parametrize("moves", DEVICES)
def test_what_is_suggested_can_be_declared(moves):
    for rate_matters in (None, False, True):
        for rings in (None, False, True):
            own = suggest_model(moves, rate_matters=rate_matters, rings=rings)
            parse_model(own.model)
            assert own.reason.startswith(own.reason[0].upper())
            assert own.reason.endswith(".")


def test_what_is_not_known_is_left_to_the_search():
    assert suggest_model("linear").model == suggest_model("linear", rate_matters=False).model
    assert "the search names them" in suggest_model("linear").reason
    with pytest.raises(ValueError, match=r"must be one of piezo, .*Got 'rock' instead"):
        suggest_model("rock")


def test_without_streamlit_the_extra_is_named(monkeypatch, capsys):
    monkeypatch.setattr("skhyst.cli._app.find_spec", lambda name: None)
    assert main(["app"]) == 1
    assert 'pip install "skhyst[app]"' in capsys.readouterr().err


# ----------------------------------------------------------------------------------- the page


def recording(top=np.inf, **names):
    rng = np.random.default_rng(0)
    time = np.arange(600) * 2.0
    drive = 5.0 * np.sin(2e-2 * time)
    response = np.minimum(2.0 * drive, top) + 0.05 * rng.normal(size=600)
    table = pd.DataFrame({"time [ms]": time, "voltage [V]": drive, "position [um]": response})
    return table.rename(columns=names).to_csv(index=False).encode()


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    # the page takes this place, from where new processes would run it
    monkeypatch.setitem(sys.modules, "__main__", sys.modules["__main__"])
    pytest.importorskip("streamlit")
    pytest.importorskip("skops")
    pytest.importorskip("matplotlib")
    testing = pytest.importorskip("streamlit.testing.v1")
    return testing.AppTest.from_file(str(PAGE), default_timeout=200).run()


def upload(page, content, name="stage.csv"):
    page.file_uploader[0].upload(name, content, "text/csv").run()
    assert not page.exception
    return page


def labelled(widgets, label):
    return next(widget for widget in widgets if widget.label == label)


def search(page):
    labelled(page.selectbox, "What moves?").select("linear")
    labelled(page.multiselect, "Effects").set_value(["output_saturation"])
    labelled(page.button, "Search").click().run()
    assert not page.exception
    return page


@pytest.mark.slow
def test_from_a_file_to_the_effect_and_the_next_drive(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    upload(page, recording(top=8.0))
    chosen = [labelled(page.selectbox, role).value for role in ("Drive", "Response", "Time")]
    assert chosen == ["voltage [V]", "position [um]", "time [ms]"]
    assert "600 samples in 1 record, one every 0.002 s" in [own.value for own in page.caption]
    search(page)
    assert page.header[-1].value == "Missing: output_saturation"
    found = page.session_state.found
    Path("recording.csv").write_bytes(recording(top=8.0))
    assert main([*shlex.split(found["report"].command)[1:], "--jobs", "1", "--quiet"]) == 0
    assert "missing: output_saturation\n" in capsys.readouterr().out
    labelled(page.button, "Propose").click().run()
    assert found["next"].reason in [own.value for own in page.markdown]
    labelled(page.number_input, "Lowest drive (V)").set_value(9.0)
    labelled(page.button, "Propose").click().run()
    assert "limits" in page.error[0].value
    assert not page.exception


def test_nothing_is_missing(page):
    assert search(upload(page, recording())).header[-1].value == "Nothing is missing"


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("stage.csv", b"", "empty"),
        ("stage.npy", b"\x93NUMPY no array", "recording.npy"),
        ("stage.exe", b"MZ", "exe"),
    ],
)
def test_a_bad_file_is_told_in_a_sentence(page, name, content, sentence):
    upload(page, content, name)
    assert sentence in page.error[0].value
    assert "Traceback" not in page.error[0].value
    assert not page.button


def test_columns_that_nothing_tells_are_asked_for(page):
    names = {"voltage [V]": "a", "position [um]": "b"}
    upload(page, recording(**names))
    assert "pass drive=NAME" in page.info[0].value
    labelled(page.selectbox, "Drive").select("a")
    labelled(page.selectbox, "Response").select("b").run()
    assert labelled(page.button, "Search")


def test_a_model_that_is_none_is_told_in_a_sentence(page):
    upload(page, recording())
    labelled(page.text_input, "Model").set_value("gian")
    labelled(page.button, "Search").click().run()
    assert not page.exception
    assert "did you mean" in page.error[0].value
