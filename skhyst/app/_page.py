"""The page of `skhyst app`, which Streamlit runs from top to bottom at every click.

Results of a search are kept in the session. A click while a search runs, such as on Stop, makes
Streamlit raise an exception in the progress callback of the search, which ends it.
"""

import shlex
import warnings
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import altair as alt
import numpy as np
import pandas as pd
import streamlit as st

from skhyst.app._processes import own_processes
from skhyst.app._suggestion import DEVICES, suggest_model
from skhyst.diagnosis import EffectSearchCV, effect_names, next_experiment
from skhyst.discovery import parse_model
from skhyst.persistence import save_model
from skhyst.records import inspect_recording, read_records

_POINTS = 1500  # parts of a curve, each drawn by its smallest and largest value
_LONG = 5000  # number of samples above which starting processes saves time
_FROM_FILE = "as in the file"
_NO_COLUMN = "none"


def main():
    """Draw the page."""
    st.set_page_config("skhyst", layout="wide")
    st.title("What does my model lack?")
    st.caption("From a recording to the effect that is missing. Nothing leaves this machine.")
    path = _upload()
    reading = _roles(path)
    _draw(path, reading)
    model, options = _model(), _options()
    reading["on_missing"] = options.pop("on_missing")
    if st.button("Search", type="primary"):
        with _sentences():
            st.session_state.found = _search(path, reading, model, options)
            st.rerun()
    if "found" in st.session_state:
        _result(st.session_state.found)


@contextmanager
def _sentences():
    """Show warnings, and an error of the data or the options as a sentence, which ends the page."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        try:
            yield
        except (ValueError, TypeError, OSError, ImportError, NotImplementedError) as error:
            st.error(str(error))
            st.stop()
        finally:
            for text in dict.fromkeys(str(one.message) for one in caught):
                st.warning(text)


def _upload():
    """Return the path of the uploaded file, in a temporary folder."""
    about = "csv, txt, xlsx, mat, npy, json, hdf5, parquet, feather, tdms, wav"
    uploaded = st.file_uploader(f"Recording: {about}")
    if uploaded is None:
        st.session_state.pop("found", None)
        st.stop()
    if "folder" not in st.session_state:
        st.session_state.folder = mkdtemp()
    path = Path(st.session_state.folder, uploaded.file_id, "recording")
    path = path.with_suffix(Path(uploaded.name).suffix.lower())
    if not path.exists():
        st.session_state.pop("found", None)
        path.parent.mkdir()
        path.write_bytes(uploaded.getbuffer())
    return path


@st.cache_data(max_entries=4, show_spinner="Reading")
def _overview(path, reading):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        overview = inspect_recording(path, **reading)
    return overview, [str(one.message) for one in caught]


def _roles(path):
    """Return the options of `read_records`: the recognised columns, unless others are chosen."""
    st.header("Columns")
    with _sentences():
        overview, _ = _overview(path, {})
    names = [column.name for column in overview.columns]
    known = {column.role: column for column in overview.columns if column.role}
    roles = {}
    for place, role in zip(st.columns(4), ("drive", "response", "time", "record"), strict=True):
        optional = role in ("time", "record")
        listed = [_NO_COLUMN, *names] if optional else names
        start = listed.index(known[role].name) if role in known else 0 if optional else None
        about = known[role].reason if role in known else None
        roles[role] = place.selectbox(role.capitalize(), listed, start, help=about)
    if None in roles.values():
        st.info(" ".join(overview.faults) or "Choose the drive and the response.")
        st.stop()
    reading = {role: name for role, name in roles.items() if name != _NO_COLUMN}
    left = [name for name in names if name not in roles.values()]
    inputs, unit, rate = st.columns([2, 1, 1])
    reading["auxiliary"] = inputs.multiselect("Further inputs", left)
    units = [_FROM_FILE, "s", "ms", "us", "ns", "min", "h"]
    if "time" in reading:
        time_unit = unit.selectbox("Unit of the time", units)
        reading["time_unit"] = None if time_unit == _FROM_FILE else time_unit
    else:
        reading["sampling_rate"] = rate.number_input("Sampling rate (Hz)", 0.0) or None
    return reading


def _draw(path, reading):
    """Draw drive and response over time, and the loop; show warnings and faults."""
    with _sentences():
        overview, warned = _overview(path, reading)
    for text in [*warned, *overview.faults]:
        st.warning(text)
    if overview.X is None:
        st.stop()
    drive, response = overview.X.columns[0], overview.y.name
    columns = {"drive": overview.X.iloc[:, 0].to_numpy(), "response": overview.y.to_numpy()}
    slices = overview.records
    time = np.concatenate([s.dt * np.arange(s.n_samples) for s in slices]) if slices else None
    table = pd.DataFrame(columns)
    table["record"] = overview.X.index.get_level_values("record").astype(str)
    table["time"] = np.arange(len(table)) if time is None else time
    unit = "s" if slices and slices[0].time_unit == "s" else "sample"
    series, loop = st.columns([2, 1])
    across = alt.X("time", title=f"time since the record's start ({unit})")
    color = alt.Color("record", legend=None)
    for name, title in (("response", response), ("drive", drive)):
        up = alt.Y(name, title=title).scale(zero=False)
        curve = alt.Chart(table.iloc[_outline(table[name])]).mark_line(strokeWidth=1)
        curve = curve.encode(across, up, color).properties(height=180)
        series.altair_chart(curve.interactive(bind_y=False))
    kept = np.linspace(0, len(table) - 1, min(len(table), 2 * _POINTS)).astype(int)
    part = table.iloc[kept].assign(order=kept)
    across, up = alt.X("drive", title=drive), alt.Y("response", title=response)
    chart = alt.Chart(part).mark_line(strokeWidth=1).properties(height=376)
    chart = chart.encode(across.scale(zero=False), up.scale(zero=False), color, order="order")
    loop.altair_chart(chart.interactive())
    every = ", ".join(f"{dt:g} {unit}" for dt in sorted({s.dt for s in slices}))
    many = "1 record" if len(slices) == 1 else f"{len(slices)} records"
    st.caption(f"{len(table)} samples in {many}, one every {every or 'unknown interval'}")


def _outline(values):
    """Return the rows of the smallest and the largest value of each part of a signal."""
    values = np.asarray(values)
    parts = np.array_split(np.arange(len(values)), min(_POINTS, len(values)))
    return np.unique([[p[values[p].argmin()], p[values[p].argmax()]] for p in parts])


def _model():
    """Return the declared model as text: what three questions suggest, or another."""
    st.header("Declared model")
    answers = {"I do not know": None, "no": False, "yes": True}
    devices, rate, ringing = st.columns([2, 1, 1])
    moves = devices.selectbox("What moves?", list(DEVICES), format_func=DEVICES.get)
    ask = {"options": list(answers), "horizontal": True}
    fast = rate.radio("Does it matter how fast you drive?", **ask)
    rings = ringing.radio("Is there a mass or a spring that rings?", **ask)
    own = suggest_model(moves, rate_matters=answers[fast], rings=answers[rings])
    help_ = "`skhyst models` lists all; + puts models in series, options are in parentheses."
    model = st.text_input("Model", own.model, key=f"model {own.model}", help=help_)
    if model == own.model:
        st.caption(own.reason)
    return model


def _options():
    """Return the parameters of the search, and ``on_missing`` of reading."""
    with st.expander("Options"):
        effects = st.multiselect("Effects", effect_names(), placeholder="all")
        folds, seed, missing = st.columns(3)
        options = {
            "effects": effects or "all",
            "cv": folds.number_input("Folds", 2, 20, 5),
            "random_state": seed.number_input("Seed", 0, 2**31 - 1, 0),
            "on_missing": missing.selectbox("Lost readings", ["raise", "drop", "interpolate"]),
        }
        even = st.checkbox("Interpolate readings that are not evenly spaced")
        return options | {"resample": "auto" if even else None}


def _search(path, reading, model, options):
    """Run the search; return it with its report, HTML page and saved model."""
    st.button("Stop")
    X, y = read_records(path, **reading)
    n_jobs = -1 if len(X) > _LONG else 1
    search = EffectSearchCV(parse_model(model), n_jobs=n_jobs, unknown=True, **options)
    with st.status("Searching", expanded=True) as status:
        bar = st.progress(0.0)

        def show(progress):
            if progress.text:
                status.write(progress.text)
            if progress.total:
                about = f"round {progress.round}: {progress.trying}, {progress.seconds:.0f} s"
                bar.progress(progress.done / progress.total, about)

        with own_processes():
            search.fit(X, y, on_progress=show)
        status.update(label="Writing the report")
        report = search.report(_command(path, reading, model, options))
        page = report.to_html()
    with TemporaryDirectory() as folder:
        file = Path(folder, "model.skops")
        save_model(search.best_estimator_, file)
        own = file.read_bytes()
    return {"search": search, "report": report, "page": page, "model": own}


def _command(path, reading, model, options):
    """Return the command that does the same."""
    words = ["skhyst", "diagnose", path.name, "--model", model]
    for name, value in reading.items():
        values = value if isinstance(value, list) else [value]
        for own in values:
            words += [] if own is None else [f"--{name.replace('_', '-')}", str(own)]
    words += ["--folds", str(options["cv"]), "--seed", str(options["random_state"])]
    words += ["--resample", "auto"] if options["resample"] else []
    words += [] if options["effects"] == "all" else ["--effects", ",".join(options["effects"])]
    return shlex.join(words)


def _result(found):
    """Show the verdict, the downloads and the report."""
    report = found["report"]
    st.header(report.headline)
    for place, (label, data, name) in zip(
        st.columns(3),
        (
            ("Report", found["page"], "report.html"),
            ("Model", found["model"], "model.skops"),
            ("Numbers", report.to_json(), "result.json"),
        ),
        strict=True,
    ):
        place.download_button(label, data, name, on_click="ignore", width="stretch")
    _next(found)
    st.iframe(found["page"], height=900)


def _next(found):
    """Ask for the limits of the drive, and offer the drive to record next."""
    search = found["search"]
    with st.expander("What to record next"), st.form("next"):
        low, high, rate = st.columns(3)
        unit = search.units_.drive or "units of the drive"
        ends = np.min(search.drive_), np.max(search.drive_)
        low, high = (
            place.number_input(f"{name} drive ({unit})", value=float(end), format="%g")
            for place, name, end in zip((low, high), ("Lowest", "Highest"), ends, strict=True)
        )
        per = search.units_.time
        rate = rate.number_input(f"Largest slope ({unit}/{per})", 0.0, None, None, format="%g")
        if st.form_submit_button("Propose"):
            with _sentences():
                found["next"] = next_experiment(search, (low, high), rate)
    if "next" in found:
        experiment = found["next"]
        st.write(experiment.reason)
        st.line_chart(experiment.drive, height=200)
        data = experiment.from_rest().to_csv()
        st.download_button("Next drive", data, "next_drive.csv", on_click="ignore")


if __name__ == "__main__":
    main()
