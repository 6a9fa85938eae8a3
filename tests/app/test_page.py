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
from skhyst.app._samples import SAMPLES, sample_recording
from skhyst.app._suggestion import DEVICES
from skhyst.app._words import page_message
from skhyst.cli import main
from skhyst.discovery import parse_model
from skhyst.exceptions import TimeUnitWarning
from skhyst.io import recognise_columns
from skhyst.records import read_records, record_slices
from skhyst.records._data_quality import _ADVICE

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


def uneven(name="t [s]"):
    time = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 50))
    return pd.DataFrame({name: time, "u": np.sin(time), "y": np.cos(time)})


@pytest.mark.parametrize(
    "asked",
    [
        lambda: recognise_columns(pd.DataFrame({"a": [1, 3, 2], "b": [0, 2, 1]})),
        lambda: read_records(pd.DataFrame({"u": [1, 3, 2], "y": [0, 2, -9999]})),
        lambda: record_slices(*read_records(uneven())),
        lambda: read_records(uneven("t")),
        lambda: read_records(uneven(), sampling_rate=-1.0),
    ],
)
def test_messages_have_the_words_of_the_page(asked):
    """No argument of Python, no function, no option of the command line."""
    with pytest.raises((ValueError, TimeUnitWarning)) as error:
        asked()
    spoken = ("=", "skhyst.", "parameter", "resample_", "read_records", "time_unit", "splitter")
    assert any(word in str(error.value) for word in spoken)
    assert not [word for word in spoken if word in page_message(str(error.value))]


def test_advice_has_the_words_of_the_page():
    for advice in _ADVICE.values():
        assert "--" not in page_message(advice)
        assert "skhyst." not in page_message(advice)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_recording_to_try_is_read_without_a_question(name):
    _, table = sample_recording(name)
    assert set(recognise_columns(table)) == {"drive", "response", "time"}


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


def shown(elements):
    """Return texts as they are seen."""
    return [element.value.replace("\\", "") for element in elements]


def role_of(page, name):
    return labelled(page.selectbox, f"Role of {name}")


def search(page, *effects):
    labelled(page.selectbox, "What moves?").select("linear")
    labelled(page.multiselect, "Effects").set_value(list(effects))
    labelled(page.button, "Search").click().run()
    assert not page.exception
    return page.session_state.board[-1]


@pytest.mark.slow
def test_from_a_file_to_the_effect_the_next_drive_and_a_board(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    upload(page, recording(top=8.0))
    assert "600 samples in 1 record, one every 0.002 s (500 Hz)" in [
        own.value for own in page.caption
    ]
    found = search(page, "output_saturation")
    assert shown(page.header)[-1] == "Missing: output_saturation"
    Path("stage.csv").write_bytes(recording(top=8.0))
    assert main([*shlex.split(found["report"].command)[1:], "--jobs", "1", "--quiet"]) == 0
    assert "missing: output_saturation\n" in capsys.readouterr().out
    labelled(page.button, "Propose").click().run()
    assert found["next"].reason in shown(page.markdown)
    labelled(page.number_input, "Lowest drive (V)").set_value(9.0)
    labelled(page.button, "Propose").click().run()
    assert "limits" in page.error[0].value
    search(page, "offset")
    table = page.table[0].value
    assert list(table["missing"]) == [r"output\_saturation", "nothing"]
    assert list(table["recording"]) == ["stage.csv"] * 2
    assert labelled(page.selectbox, "Report of").value == 1
    labelled(page.button, "Clear the board").click().run()
    assert not page.table
    assert not page.exception


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("stage.csv", b"", "empty"),
        ("stage.npy", b"\x93NUMPY no array", "stage.npy"),
        ("stage.exe", b"MZ", "exe"),
        ("stage.csv", b"t,u,y\n" + b"".join(b"%d,3,%d\n" % (k, k % 7) for k in range(60)), "move"),
    ],
)
def test_a_bad_file_is_told_in_a_sentence(page, name, content, sentence):
    upload(page, content, name)
    assert sentence in page.error[0].value
    assert "Traceback" not in page.error[0].value
    assert not page.button


@pytest.mark.slow
def test_roles_units_and_rates_are_picked(page):
    """What nothing tells is asked for, one answer settles the rest, and nothing stale is left."""
    upload(page, recording(**{"voltage [V]": "a", "position [um]": "b", "time [ms]": "c"}))
    assert page.info[0].value == "Pick the drive and the response in the table."
    role_of(page, "a").select("drive").run()
    assert role_of(page, "b").value == "response"
    assert not page.info
    assert labelled(page.button, "Search")
    role_of(page, "b").select("drive").run()  # which no two columns have
    assert (role_of(page, "a").value, role_of(page, "b").value) == ("response", "drive")
    role_of(page, "c").select("").run()
    labelled(page.number_input, "Sampling rate (Hz)").set_value(500.0)
    labelled(page.text_input, "Unit of b").set_value("mV").run()
    assert "600 samples in 1 record, one every 0.002 s (500 Hz)" in [
        own.value for own in page.caption
    ]
    role_of(page, "c").select("drive").run()
    assert "counts the time" in page.error[0].value  # at once, not when it is searched
    assert not page.button


def test_several_files_are_records_or_columns(page):
    uploader = page.file_uploader[0]
    files = {"slow.csv": recording(), "fast.csv": recording(top=8.0)}
    uploader.set_value([(name, content, "text/csv") for name, content in files.items()]).run()
    assert "1200 samples in 2 records, one every 0.002 s (500 Hz)" in [
        own.value for own in page.caption
    ]
    page.radio[0].set_value("columns of one recording").run()
    assert page.info[0].value == "Pick the response in the table."
    role_of(page, "fast position [um]").select("response").run()
    assert "600 samples in 1 record, one every 0.002 s (500 Hz)" in [
        own.value for own in page.caption
    ]


def test_a_model_that_is_none_is_told_in_a_sentence(page):
    labelled(page.selectbox, "Or a recording to try").select(SAMPLES[0]).run()
    labelled(page.text_input, "Model").set_value("gian")
    labelled(page.button, "Search").click().run()
    assert not page.exception
    assert "did you mean" in page.error[0].value
