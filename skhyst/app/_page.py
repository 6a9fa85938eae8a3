"""The page of `skhyst app`, which Streamlit runs from top to bottom at every click.

Searches are kept in the session, on a board. A click while a search runs, such as on Stop, makes
Streamlit raise an exception in the progress callback of the search, which ends it.
"""

import re
import shlex
import time
import warnings
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import altair as alt
import numpy as np
import pandas as pd
import streamlit as st

from skhyst._envelope import envelope
from skhyst._validation import refuse_no_experiment, refuse_still
from skhyst.app._processes import own_processes
from skhyst.app._samples import SAMPLES, sample_recording
from skhyst.app._suggestion import DEVICES, suggest_model
from skhyst.app._words import FIELDS, page_message
from skhyst.diagnosis import EffectSearchCV, Report, effect_names, next_experiment
from skhyst.discovery import parse_model
from skhyst.inspection import compare_models
from skhyst.io import inspect_columns, join_files, unit_of
from skhyst.persistence import save_model
from skhyst.records import faults_of_records, read_records, record_slices, resample_records

_POINTS = 1500  # parts of a curve, each drawn by its smallest and largest value
_LONG = 5000  # number of samples above which starting processes saves time
_MANY = 24  # columns above which they are looked for by name
_SINGLE = ("drive", "response", "time", "record")  # roles that one column has
_ROLES = {
    "": "not used",
    "drive": "drive: what is set",
    "response": "response: what is measured",
    "time": "time",
    "record": "label of the record",
    "auxiliary": "further input",
}
_SEPARATORS = {"as found": None, ",": ",", ";": ";", "tab": "\t", "blanks": " "}
_SIGNS = {"as found": None, ".": ".", ",": ","}
_COMPARED = "I do not know: compare models"


def main():
    """Draw the page."""
    st.set_page_config("skhyst", layout="wide")
    st.title("What does my model lack?")
    st.caption("From a recording to the effect that is missing. Nothing leaves this machine.")
    if "running" in st.session_state:
        st.info(f"Stopped: {_plain(st.session_state.pop('running'))}. Nothing of it is kept.")
    above, below = st.container(), st.container()
    with below:  # drawn first, since the part above may end the page
        _board()
    with above:
        _new_search()


def _new_search():
    """Ask for a recording and a model, and search."""
    files = _recording()
    reading, even = _columns(files)
    X, y = _draw(files, reading, even)
    model, options = _model(), _options()
    options["resample"] = "auto" if even else None
    if st.button("Search", type="primary"):
        with _sentences():
            found = _search(files, reading, model, options, X, y)
        st.session_state.setdefault("board", []).append(found)
        st.session_state.new = len(st.session_state.board) - 1
        st.rerun()


@contextmanager
def _sentences(ends=True):
    """Show warnings, and an error of the data or the options as a sentence; it ends the page."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        try:
            yield
        except (ValueError, OSError, ImportError, NotImplementedError) as error:
            st.session_state.pop("running", None)
            st.error(_told(error))
            if ends:
                st.stop()
        finally:
            for text in dict.fromkeys(_told(one.message) for one in caught):
                st.warning(text)


def _told(message):
    return _plain(page_message(str(message)))


def _plain(text):
    """Return a text that Markdown shows as it is."""
    return re.sub(r"([\\`*_{}\[\]()#+!$|<>~:-])", r"\\\1", text)


# -------------------------------------------------------------------------------- the recording


def _recording():
    """Return the paths of the files, and whether they hold the columns of one recording."""
    st.header("Recording")
    upload, sample = st.columns([2, 1])
    about = "csv, txt, lvm, xlsx, mat, npy, json, jsonl, hdf5, parquet, feather, tdms, wav"
    uploaded = upload.file_uploader("Files", accept_multiple_files=True, help=about)
    device = sample.selectbox(
        "Or a recording to try", SAMPLES, None, placeholder="none", disabled=bool(uploaded)
    )
    if "folder" not in st.session_state:
        st.session_state.folder = mkdtemp()
    if uploaded:
        paths = [Path(one.file_id, Path(one.name).name) for one in uploaded]
        contents = [one.getbuffer() for one in uploaded]
    elif device:
        name, table = sample_recording(device)
        paths, contents = [Path("sample", name)], [table.to_csv(index=False).encode()]
    else:
        st.stop()
    paths = [Path(st.session_state.folder, path) for path in paths]
    for path, content in zip(paths, contents, strict=True):
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
    kinds = ["a record of one device each", "columns of one recording"]
    joined = len(paths) > 1 and st.radio("The files are", kinds, horizontal=True) == kinds[1]
    return tuple(paths), joined


@st.cache_data(max_entries=4, show_spinner="Reading")
def _overview(files, layout, given):
    """Return the columns, their roles, and open or suspicious points."""
    paths, joined = files
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # reported after reading is complete
        source = join_files(paths, **layout) if joined else paths[0]
        more = {} if joined else layout
        _, columns, _, faults = inspect_columns(source, **more, **given)
    return columns, faults


@st.cache_data(max_entries=4, show_spinner="Reading")
def _signals(files, reading, even):
    """Return X, y, their records, and warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        X, y = _read(files, reading)
        if even:
            X, y = resample_records(X, y, dt="auto")
        slices = record_slices(X, y, one_interval=False, bridge=True)
        refuse_still(X.iloc[:, 0].to_numpy())
        refuse_no_experiment(X.to_numpy(), y.to_numpy(), slices)
    told = [str(one.message) for one in caught] + faults_of_records(X, y, slices)
    return X, y, slices, told


def _read(files, reading):
    paths, joined = files
    if joined:
        layout = {name: reading[name] for name in ("delimiter", "decimal")}
        return read_records(join_files(paths, **layout), **reading | dict.fromkeys(layout))
    return read_records(list(paths) if len(paths) > 1 else paths[0], **reading)


def _layout():
    """Return options of reading that no column has, and whether to interpolate uneven times."""
    with st.expander("How the file is read"):
        places = st.columns(5)
        separator = places[0].selectbox(FIELDS["delimiter"], _SEPARATORS)
        sign = places[1].selectbox(FIELDS["decimal"], _SIGNS)
        kinds = {"tell me": "raise", "interpolate": "interpolate", "drop": "drop"}
        lost = places[2].selectbox(FIELDS["on_missing"], kinds)
        code = places[3].number_input(FIELDS["missing_code"], value=None, format="%g")
        uneven = places[4].selectbox(FIELDS["resample"], ["tell me", "interpolate"])
    layout = {"delimiter": _SEPARATORS[separator], "decimal": _SIGNS[sign]}
    return layout, {"on_missing": kinds[lost], "missing_code": code}, uneven == "interpolate"


def _columns(files):
    """Return the parameters of `read_records`: recognised columns, unless others are chosen."""
    layout, more, even = _layout()
    chosen = st.session_state.setdefault("roles", {}).setdefault(files, {})
    given = {role: name for name, role in chosen.items() if role in _SINGLE}
    given["auxiliary"] = [name for name, role in chosen.items() if role == "auxiliary"]
    with _sentences():
        columns, faults = _overview(files, layout, given)
    roles = {column.name: chosen.get(column.name, column.role) for column in columns}
    asked = st.container()  # above a table that may be long
    units = _table(files, columns, roles)
    reading = {role: name for name, role in roles.items() if role in _SINGLE}
    reading["auxiliary"] = [name for name, role in roles.items() if role == "auxiliary"]
    reading |= layout | more | {"units": units}
    clock, _ = st.columns([1, 3])
    if "time" in reading:
        known = ["as in the file", "s", "ms", "us", "ns", "min", "h"]
        unit = clock.selectbox(FIELDS["time_unit"], known)
        reading["time_unit"] = None if unit == known[0] else unit
    else:
        known = [f"{1.0 / dt:g}" for dt in dict.fromkeys(c.interval for c in columns) if dt]
        label = f"{FIELDS['sampling_rate']} (Hz)"
        about = f"{' or '.join(known)}, as in the file" if known else "not in the file"
        rate = clock.number_input(label, 0.0, value=None, format="%g", placeholder=about)
        reading["sampling_rate"] = rate or None
    open_ = [role for role in ("drive", "response") if role not in reading]
    for fault in faults:
        if "pass time=" in fault and "time" not in chosen.values():
            asked.info("More than one column may be the time: pick it in the table.")
        elif open_ and "recorded at once" in fault:
            asked.info(_told(fault))
        elif "=NAME" not in fault and not fault.startswith("Recognised"):
            st.warning(_told(fault))
    if open_:
        asked.info(f"Pick the {' and the '.join(open_)} in the table.")
        st.stop()
    return reading, even


def _table(files, columns, roles):
    """Draw a row for each column, with its picture, and return the units that are changed."""
    shown = columns
    if len(columns) > _MANY:
        asked = st.text_input(f"Find one of {len(columns)} columns", placeholder="part of its name")
        shown = [one for one in columns if asked.lower() in one.name.lower()][:_MANY]
        shown += [one for one in columns if roles[one.name] and one not in shown]
    units = {}
    for number, column in enumerate(shown):
        name, picture, role, unit = st.columns([3, 3, 2, 1], vertical_alignment="center")
        reason = f", {column.reason}" if roles[column.name] and column.reason != "as given" else ""
        name.markdown(f"**{_plain(column.name)}**  \n{_plain(column.span + reason)}")
        if len(column.outline):
            picture.image(_little_picture(column.outline), width="stretch")
        key = f"role {number} of {column.name} in {files}"
        st.session_state[key] = roles[column.name]
        role.selectbox(
            f"Role of {column.name}",
            _ROLES,
            format_func=_ROLES.get,
            key=key,
            label_visibility="collapsed",
            on_change=_choose,
            args=(files, column.name, key, roles),
        )
        if roles[column.name] in ("drive", "response", "auxiliary"):
            stated = unit_of(column.name)
            own = unit.text_input(
                f"{FIELDS['units']} of {column.name}",
                stated,
                key=f"unit of {key}",
                label_visibility="collapsed",
                placeholder="unit",
                max_chars=12,
            ).strip()
            units |= {column.name: own} if own and own != stated else {}
    return units


def _choose(files, name, key, roles):
    """Give a column its role, take it from the column that had it, and keep all others."""
    role, chosen = st.session_state[key], st.session_state.roles[files]
    chosen |= {other: own for other, own in roles.items() if own}
    for other in [one for one, own in chosen.items() if own == role and role in _SINGLE]:
        del chosen[other]  # another role may be recognised
    chosen[name] = role


def _little_picture(outline):
    """Return a curve through numbered readings as SVG."""
    x, y = (outline - outline.min(axis=0)).T
    x, y = 1.0 + 398.0 * x / (x.max() or 1.0), 59.0 - 58.0 * y / (y.max() or 1.0)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" width="400" height="60" viewBox="0 0 400 60">'
        f'<polyline points="{points}" fill="none" stroke="#2a85c4" stroke-width="1"/></svg>'
    )


def _draw(files, reading, even):
    """Draw drive and response over time, and the loop, and return them."""
    with _sentences():
        X, y, slices, warned = _signals(files, reading, even)
    for text in warned:
        st.warning(_told(text))
    drive, response = X.columns[0], y.name
    table = pd.DataFrame({"drive": X.iloc[:, 0].to_numpy(), "response": y.to_numpy()})
    table["record"] = X.index.get_level_values("record").astype(str)
    table["time"] = np.concatenate([s.dt * np.arange(s.n_samples) for s in slices])
    unit = "s" if slices[0].time_unit == "s" else "sample"
    series, loop = st.columns([2, 1])
    across = alt.X("time", title=f"time since the record's start ({unit})")
    color = alt.Color("record", legend=None)
    for name, title in (("response", response), ("drive", drive)):
        up = alt.Y(name, title=title, axis=alt.Axis(titleFontSize=11)).scale(zero=False)
        curve = alt.Chart(table.iloc[envelope(table[name], _POINTS)]).mark_line(strokeWidth=1)
        curve = curve.encode(across, up, color).properties(height=200)
        series.altair_chart(curve.interactive(bind_y=False))
    kept = np.linspace(0, len(table) - 1, min(len(table), 2 * _POINTS)).astype(int)
    part = table.iloc[kept].assign(order=kept)
    across, up = alt.X("drive", title=drive), alt.Y("response", title=response)
    chart = alt.Chart(part).mark_line(strokeWidth=1).properties(height=416)
    chart = chart.encode(across.scale(zero=False), up.scale(zero=False), color, order="order")
    loop.altair_chart(chart.interactive())
    every = ", ".join(f"{dt:g} s ({1.0 / dt:g} Hz)" for dt in sorted({s.dt for s in slices}))
    known = f"one every {every}" if unit == "s" else "sampling rate unknown: time is in samples"
    many = "1 record" if len(slices) == 1 else f"{len(slices)} records"
    st.caption(f"{len(table)} samples in {many}, {known}")
    return X, y


# ----------------------------------------------------------------------------------- the search


def _model():
    """Return the declared model as text, "" where models are to be compared."""
    st.header("Declared model")
    answers = {"I do not know": None, "no": False, "yes": True}
    devices, rate, ringing = st.columns([2, 1, 1])
    moves = devices.selectbox(
        "What moves?", [None, *DEVICES], format_func=lambda own: DEVICES.get(own, _COMPARED)
    )
    suggested, reason = (
        "",
        (
            "A few models of one mechanism each are compared on held-out samples, and the best is "
            "declared. To declare one of your own, write it here."
        ),
    )
    if moves is not None:
        ask = {"options": list(answers), "horizontal": True}
        fast = rate.radio("Does it matter how fast you drive?", **ask)
        rings = ringing.radio("Is there a mass or a spring that rings?", **ask)
        own = suggest_model(moves, rate_matters=answers[fast], rings=answers[rings])
        suggested, reason = own.model, own.reason
    help_ = "`skhyst models` lists all; + puts models in series, options are in parentheses."
    model = st.text_input(
        "Model", suggested, key=f"model {suggested}", help=help_, placeholder="compared"
    )
    if model == suggested:
        st.caption(reason)
    return model.strip()


def _options():
    """Return the parameters of the search."""
    with st.expander("Options"):
        effects = st.multiselect(FIELDS["effects"], effect_names(), placeholder="all")
        folds, seed, _ = st.columns(3)
        return {
            "effects": effects or "all",
            "cv": folds.number_input(FIELDS["cv"], 2, 20, 5),
            "random_state": seed.number_input(FIELDS["random_state"], 0, 2**31 - 1, 0),
        }


def _search(files, reading, model, options, X, y):
    """Run the search; return it with its report, HTML page and saved model."""
    declared = parse_model(model) if model else None
    name, begin = ", ".join(path.name for path in files[0]), time.perf_counter()
    st.session_state.running = f"the search of {name}"
    st.button("Stop")
    comparison = None
    with st.status("Searching", expanded=True) as status:
        bar = st.progress(0.0, "declared model")

        def show(progress):
            if progress.text:
                status.write(_plain(progress.text))
            if progress.total:
                about = _plain(f"{progress}; {progress.seconds:.0f} s so far")
                bar.progress(progress.done / progress.total, about)

        if declared is None:
            comparison = compare_models(X, y, on_progress=show)
            model, declared = comparison.taken, parse_model(comparison.taken)
            status.write(_plain(comparison.reason))
        n_jobs = -1 if len(X) > _LONG else 1
        search = EffectSearchCV(declared, n_jobs=n_jobs, unknown=True, **options)
        with own_processes():
            search.fit(*_read(files, reading), on_progress=show)
        status.update(label="Writing the report")
        command = _command(files, reading, model, options)
        report = Report.from_search(search, command, comparison=comparison)
        page = report.to_html()
    with TemporaryDirectory() as folder:
        file = Path(folder, "model.skops")
        save_model(search.best_estimator_, file)
        own = file.read_bytes()
    del st.session_state.running
    row = {"recording": name, "declared": model, "seconds": time.perf_counter() - begin}
    return row | {"search": search, "report": report, "page": page, "model": own}


def _command(files, reading, model, options):
    """Return the command that does the same, of several records the line of Python."""
    paths, joined = files
    own = {name: value for name, value in reading.items() if value not in (None, [], {}, "raise")}
    if len(paths) > 1 and not joined:
        given = "".join(f", {name}={value!r}" for name, value in own.items())
        return f"X, y = read_records({[path.name for path in paths]}{given})"
    words = ["skhyst", "diagnose", *(path.name for path in paths), *["--join"] * joined]
    words += ["--model", model]
    for name, value in own.items():
        if name == "units":
            words += [word for pair in value.items() for word in ("--unit", "=".join(pair))]
            continue
        values = value if isinstance(value, list) else [value]
        words += [word for one in values for word in (f"--{name.replace('_', '-')}", str(one))]
    words += ["--folds", str(options["cv"]), "--seed", str(options["random_state"])]
    words += ["--resample", "auto"] if options["resample"] else []
    words += [] if options["effects"] == "all" else ["--effects", ",".join(options["effects"])]
    return shlex.join(words)


# ------------------------------------------------------------------------------------ the board


def _board():
    """Show the searches of the session side by side, and the report of one."""
    board = st.session_state.get("board", [])
    if not board:
        return
    st.header("Searches")
    rows = [_row(number, found) for number, found in enumerate(board, start=1)]
    st.html(_stacked(list(rows[0])))
    st.table(pd.DataFrame(rows).map(_plain).set_index("no."))
    if "new" in st.session_state:
        st.session_state.shown = st.session_state.pop("new")
    names = [f"{row['no.']}: {row['recording']}, {row['model']}" for row in rows]
    shown, clear = st.columns([3, 1], vertical_alignment="bottom")
    place = shown.selectbox(
        "Report of", range(len(board)), format_func=names.__getitem__, key="shown"
    )
    clear.button("Clear the board", on_click=board.clear)
    _result(board[place], place)


def _stacked(names):
    """Return a style by which a narrow page has a line for each cell of a table, with its name."""
    table = '[data-testid="stTable"] table'
    lines = " ".join(
        f"{table} tbody :is(th, td):nth-child({place})::before {{ content: '{name}: ' }}"
        for place, name in enumerate(names, start=1)
    )
    return (
        "<style>@media (max-width: 640px) { "
        f"{table} thead {{ display: none }} "
        f"{table}, {table} :is(tbody, tr) {{ display: block; width: 100% }} "
        f"{table} tr {{ padding: 0.5rem 0 }} "
        f"{table} :is(th, td) {{ display: block; border: 0; padding: 0 0.5rem; "
        "overflow-wrap: anywhere } "
        f"{table} ::before {{ opacity: 0.6 }} {lines} }}</style>"
    )


def _row(number, found):
    report, search = found["report"], found["search"]
    unit = report.units["response"]
    errors = [
        f"{value:.3g} {unit}".strip()
        for value in (search.error_before_, search.error_after_, search.noise_floor_)
    ]
    return {
        "no.": str(number),
        "recording": found["recording"],
        "model": found["declared"],
        "missing": ", ".join(search.effects_) or "nothing",
        **dict(zip(("error before", "after", "noise floor"), errors, strict=True)),
        "residual": search.verdict_,
        "time": f"{found['seconds']:.0f} s",
    }


def _result(found, number):
    """Show the verdict, the downloads and the report."""
    report = found["report"]
    st.header(_plain(report.headline))
    for place, (label, data, name) in zip(
        st.columns(3),
        (
            ("Download the report (HTML)", found["page"], "report.html"),
            ("Download the model (skops)", found["model"], "model.skops"),
            ("Download the numbers (JSON)", report.to_json(), "result.json"),
        ),
        strict=True,
    ):
        place.download_button(
            label, data, name, on_click="ignore", width="stretch", key=f"{name} {number}"
        )
    _next(found, number)
    st.iframe(found["page"], height=900)


def _next(found, number):
    """Ask for the limits of the drive, and offer the drive to record next."""
    search = found["search"]
    with st.expander("What to record next"), st.form(f"next {number}"):
        low, high, rate = st.columns(3)
        unit = search.units_.drive or "units of the drive"
        ends = np.min(search.drive_), np.max(search.drive_)
        low, high = (
            place.number_input(f"{name} drive ({unit})", value=float(f"{end:.6g}"), format="%g")
            for place, name, end in zip((low, high), ("Lowest", "Highest"), ends, strict=True)
        )
        per = search.units_.time
        rate = rate.number_input(f"Largest slope ({unit}/{per})", 0.0, None, None, format="%g")
        if st.form_submit_button("Propose"):
            found.pop("next", None)
            with _sentences(ends=False):
                found["next"] = next_experiment(search, (low, high), rate)
    if "next" in found:
        experiment = found["next"]
        st.write(_plain(experiment.reason))
        st.line_chart(experiment.drive, height=200)
        data = experiment.from_rest().to_csv()
        st.download_button(
            "Download the next drive (CSV)", data, "next_drive.csv", on_click="ignore"
        )


if __name__ == "__main__":
    main()
