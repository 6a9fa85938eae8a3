"""The report: the numbers of the search, on a page that needs nothing and runs nothing."""

import base64
import copy
import hashlib
import json
import math
import re
import sys
from html import unescape
from html.parser import HTMLParser
from importlib.resources import files
from itertools import groupby
from xml.etree import ElementTree

import html5lib
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import ValidationError, validate
from plants import make_recording

from skhyst.datasets import sine
from skhyst.diagnosis import EffectSearchCV, Experiment, Report, _report
from skhyst.diagnosis._report import next_steps
from skhyst.diagnosis._report_text import number, plus_minus
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.inspection import ModelComparisonDisplay
from skhyst.linear import Gain

HOSTILE = "<script>alert(1)</script>"
COMMAND = 'skhyst diagnose "a b.csv" --drive <x> & more'


@pytest.fixture(scope="module")
def recording():
    return make_recording("resonance", "prandtl_ishlinskii", 3, n_samples=4000)


@pytest.fixture(scope="module")
def search(recording):
    plays = PrandtlIshlinskii(thresholds=recording.truth["thresholds"])
    return EffectSearchCV(plays, effects=["resonance", "lag", "offset"], cv=2, random_state=0).fit(
        recording.X_train, recording.y_train
    )


@pytest.fixture(scope="module")
def report(search):
    return search.report(command=COMMAND)


@pytest.fixture(scope="module")
def html(report):
    return report.to_html()


@pytest.fixture(scope="module")
def markdown(report):
    return report.to_markdown()


@pytest.fixture(scope="module")
def nothing():
    """The report of a search that found nothing, in a column that wants to be a script."""
    recording = make_recording("none", "prandtl_ishlinskii", 1, n_samples=4000)
    X = recording.X_train.rename(columns={"drive": HOSTILE})
    plays = PrandtlIshlinskii(thresholds=recording.truth["thresholds"])
    search = EffectSearchCV(plays, effects=["lag", "offset"], cv=2, random_state=0)
    return search.fit(X, recording.y_train).report(command=HOSTILE)


def changed(report, **changes):
    """Return a report of other content, without pictures."""
    return Report(report.content | changes)


class Page(HTMLParser):
    """Tags, attributes and visible text of a page."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes, self.style, self._text = set(), [], "", []
        self._open = []
        self.feed(html)
        self.close()
        self.text = " ".join(" ".join(self._text).split())

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.attributes += [(tag, name, value or "") for name, value in attributes]
        self._open.append(tag)

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data):
        if "style" in self._open:
            self.style += data
        elif "svg" not in self._open and "script" not in self._open:
            self._text.append(data)


def assert_needs_nothing(html):
    page = Page(html)
    forbidden = {"link", "iframe", "object", "embed", "base", "img", "form", "video"}
    assert not page.tags & forbidden
    assert html.count("<script") == 1  # that of the page
    for _, name, value in page.attributes:
        assert not name.startswith("on")
        if name in ("href", "xlink:href", "src", "srcset", "action", "data"):
            assert value.startswith("#")
        if not name.startswith("xmlns"):
            assert "//" not in value
            assert "javascript:" not in value
    styles = page.style + "".join(v for _, name, v in page.attributes if name == "style")
    assert "@import" not in styles
    assert all(target.startswith("#") for target in re.findall(r"url\(\s*['\"]?(.)", html))
    return page


def finite_only(text):
    def refuse(constant):
        pytest.fail(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


# ------------------------------------------------------------------------------------------ page


@pytest.mark.slow
def test_page_needs_nothing_and_runs_its_own_script_alone(html):
    page = assert_needs_nothing(html)
    html5lib.HTMLParser(strict=True).parse(html)  # raises at the first error
    assert len(html) < 3e6
    assert "svg" in page.tags
    policies = [value for tag, _, value in page.attributes if tag == "meta" and "-src" in value]
    (script,) = re.findall("<script>(.*?)</script>", html, re.DOTALL)
    own = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    start = "default-src 'none'; style-src 'unsafe-inline'; script-src "
    assert policies == [f"{start}'sha256-{own}'"]


def test_page_tells_in_order(html, report):
    (claim,) = report.claims
    assert claim["effect"] == "resonance"
    page = " ".join(html.replace("&#39;", "'").split())
    landmarks = [
        f"<h1>{report.headline}</h1>",
        "<dt>How sure</dt>",
        report.sentence,
        'aria-label="Loops',
        claim["statement"],
        'aria-label="Evidence for resonance"',
        '<details class="sceptic">',
        'aria-label="Round 1"',
        "<h2>Every fold</h2>",
        'aria-label="Residuals',
        "<h2>Parameters</h2>",
        "skhyst diagnose",
    ]
    places = [page.index(mark) for mark in landmarks]
    assert places == sorted(places)


def test_sentence_carries_the_errors(report):
    for error in (report.error_before, report.error_after, report.noise_floor):
        share = number(100 * error / report.response_range)
        assert f"{number(error)} ({share} %" in report.sentence
    assert report.declared_model in report.sentence


def test_page_and_markdown_show_the_same_numbers(html, markdown, report):
    texts = Page(html).text, unescape(markdown.replace("\\", ""))
    shown = [plus_minus(row["value"], row["std"]) for row in report.claims[0]["numbers"]]
    assert all("±" in text for text in shown)
    for rows in report.parameters.values():
        shown += [plus_minus(r["value"], r["std"]) for r in rows if r["std"] is not None]
    shown += [number(r["error_after"]) for r in report.ranking if r["error_after"] is not None]
    shown += [row["effect"] for row in report.not_it]
    shown += [number(row["error_after"]) for row in report.folds]
    shown += [*report.versions, *report.versions.values(), COMMAND]
    for text in texts:
        assert [own for own in shown if own not in text] == []


@pytest.mark.slow
def test_column_that_wants_to_be_a_script(nothing):
    assert nothing.drive_name == HOSTILE
    html = nothing.to_html()
    page = assert_needs_nothing(html)
    assert HOSTILE in page.text
    assert HOSTILE not in html
    assert "<script" not in re.sub(r"\\.", "", nothing.to_markdown())
    assert json.loads(nothing.to_json())["drive_name"] == HOSTILE


@pytest.mark.parametrize(
    ("drive", "response"),
    [
        (r"a$b$ $\nope{ ], |*`_", "line\nbreak"),
        pytest.param("x" * 300, "\x00\x1b\ud800]]>", marks=pytest.mark.slow),
    ],
)
def test_any_column_name_is_drawn(nothing, tmp_path, drive, response):
    names = {"drive_name": drive, "response_name": response}
    named = changed(nothing, **names)
    named.displays = {key: copy.copy(display) for key, display in nothing.displays.items()}
    for display in named.displays.values():
        display.drive_name, display.response_name = drive, response
    html = named.to_html(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == html
    assert_needs_nothing(html)
    pictures = re.findall(r"<svg.*?</svg>", html, re.DOTALL)
    assert pictures
    for picture in pictures:
        ElementTree.fromstring(picture)  # XML, whatever the name
    assert tables_are_whole(named.to_markdown())
    for form in (named.to_markdown, named.to_json):
        form(tmp_path / "report")
        assert (tmp_path / "report").read_text(encoding="utf-8") == form()


# --------------------------------------------------------------------------------------- verdicts


def ambiguous(report):
    claim = {**report.claims[0], "ambiguous_with": ["lag"], "experiment": "Ring it, then listen."}
    return {"claims": [claim]}


def provisional(report):
    claims = [{**claim, "provisional": True} for claim in report.claims]
    return {"claims": claims, "verdict": "unexplained"}


def full(report):
    settings = report.settings | {"max_effects": len(report.claims)}
    return {"settings": settings, "verdict": "unexplained"}


def half_noise(report):
    """Half the error that is left cannot be a response, and a black box predicts nothing of it."""
    error = report.error_after
    return {"verdict": "unexplained", "noise_floor": 0.5 * error, "noise_ceiling": error}


def worse_on_records(report):
    return {"error_after": 2.0 * report.error_before}


def of_one_candidate(report):
    row = {"round": 1, "effect": "lag", "screen": 1e-5, "n_parameters": 1, "claimed": False}
    row |= {"error_before": 1.0, "error_after": None, "p_value": None}
    return {"ranking": [row]}


STRONGEST = "The residual of the declared model is strongest"
SAID = [  # report, changes of it, what it says, and what it does not say
    ("nothing", {}, ["Nothing is missing", "its held-out error is"], "nexplained"),
    (
        "nothing",
        {"verdict": "unexplained"},
        ["Unexplained", "No effect is claimed"],
        "Nothing is missing",
    ),
    ("nothing", {"ranking": [], "not_it": []}, ["No effect was tried"], "Explains"),
    ("nothing", of_one_candidate, ["No candidate explains enough", "< 0.1 %"], "claimed |"),
    (
        "report",
        {"verdict": "unexplained"},
        ["Missing: resonance; and unexplained structure"],
        "No effect is claimed",
    ),
    (
        "nothing",
        {"verdict": "undetermined"},
        ["Undetermined", "this recording does not", "do not predict each other", "slow noise "],
        "Nothing is missing",
    ),
    (
        "report",
        {"verdict": "undetermined"},
        ["Missing: resonance; more may be missing", "this recording does not determine"],
        "nexplained",
    ),
    (
        "report",
        provisional,
        [
            "which may stand for an effect that is not on the list",
            "structure that no effect explains",
        ],
        "Nothing",
    ),
    ("report", {}, ["Missing: resonance", "the held-out error falls from"], "rovisional"),
    ("report", worse_on_records, ["but on whole records it rises from"], "held-out error falls"),
    ("report", half_noise, ["at most 75 % of the power", "Not known: its law"], "at least"),
    ("report", {"next_steps": ["a", "b"]}, ["What to measure next"], "Not known"),
    ("report", ambiguous, ["do not distinguish it from lag", "Ring it, then listen."], "dropped"),
    (
        "report",
        {"dropped": ["my_lag"]},
        ["my_lag was added and removed again: without it the held-out error"],
        "unexplained",
    ),
    ("report", full, ["Unexplained structure", "no more effects than max_effects"], "no further"),
    ("report", {}, ["mode stores and returns energy", STRONGEST], "dropped"),
]


@pytest.mark.parametrize(("which", "changes", "said", "unsaid"), SAID)
def test_what_is_said(request, which, changes, said, unsaid):
    report = request.getfixturevalue(which)
    other = changed(report, **(changes(report) if callable(changes) else changes))
    for text in (Page(other.to_html()).text, other.to_markdown().replace("\\", "")):
        text = text.replace("\N{NO-BREAK SPACE}", " ")
        assert all(words in text for words in said)
        assert unsaid not in text


def test_the_residual_is_strongest_at_the_mode(report):
    (claim,) = report.claims
    place = next(row for row in report.declared_location if row["by"] == "frequency")
    frequency = next(r["value"] for r in claim["numbers"] if r["name"] == "natural frequency")
    assert place["low"] / 2.0 < frequency < 2.0 * place["high"]


def test_what_to_measure_next():
    claim = {"effect": "lag", "ambiguous_with": ["delay"], "experiment": "Sweep."}
    miss = {"effect": "creep", "p_value": 0.2, "error_before": 2.0, "error_after": 1.8}
    place = {"by": "frequency", "record": None, "low": 1.0, "high": 2.0, "unit": "Hz"}
    place |= {"concentration": 3.0, "concentration_low": 2.0, "concentration_high": 4.0}

    def steps(claims=(), suspects=(), location=(), verdict="noise", faults=(), experiment=None):
        settings = {"alpha": 0.01, "max_effects": 3, "min_improvement": 0.05}
        return next_steps(claims, suspects, location, verdict, faults, settings, "", experiment)

    assert steps() == []
    told, proposal = steps([claim])
    assert told == "To distinguish lag from delay: Sweep."
    assert "skhyst next" in proposal
    (proposal,) = steps(experiment=Experiment(None, "", "Triangle of 2 Hz: it tells.", 1.0))
    assert "so far: Triangle of 2 Hz: it tells. As a file" in proposal
    assert steps([claim | {"ambiguous_with": []}]) == []
    (step,) = steps(suspects=[miss, miss | {"p_value": 0.001}])
    assert step.startswith("creep would reduce the error by 10 %")
    assert "Step and rest" in step
    assert "from 1.00 to 2.00 Hz" in steps(location=[place], verdict="unexplained")[0]
    assert "repeat one record" in steps(verdict="unexplained")[0]
    found = steps([claim], [miss], [place], "unexplained", [{"fault": "lost_reading"}])
    assert len(found) == 5
    assert found[0].startswith("Correct the faults of the recording (lost reading)")
    assert "max_effects = 3" in steps(3 * [claim], verdict="unexplained")[3]


def test_the_drive_to_record_next_stays_within_what_was_recorded(report):
    X = sine(1.0, 2.0, n_cycles=4, dt=5e-3)
    u = X["drive"].to_numpy()
    late = np.interp(np.arange(len(u)) - 2.0, np.arange(len(u)), u)
    y = late + 0.02 * np.random.default_rng(0).normal(size=len(u))
    found = EffectSearchCV(Gain(), effects=["delay", "lag"]).fit(X, y).report()
    assert found.claims[0]["ambiguous_with"] == ["lag"]
    (_, time, drive, _), *_ = found.displays["next"].picture.curves
    assert u.min() <= drive.min() < drive.max() <= u.max()
    rate = np.abs(np.diff(drive) / np.diff(time)).max()
    assert rate <= np.abs(np.diff(u)).max() / 5e-3 * (1.0 + 1e-9)
    assert drive[0] == drive[-1] == 0.0
    assert any(step.startswith("Record next") for step in found.next_steps)
    assert "next" not in report.displays  # nothing is open


def test_held_out_data_are_reported(search, recording):
    kept = (recording.X_test, recording.y_test)
    report = Report.from_search(search, held_out=kept)
    assert report.held_out["n_samples"] == len(recording.y_test)
    for name, declared in (("before", True), ("after", False)):
        error = search.held_out_error(*kept, declared=declared)
        assert report.held_out[f"error_{name}"] == error
        assert number(error) in report.to_markdown()


# ------------------------------------------------------------------------------------------- data


def by_candidate(rows):
    rows = pd.DataFrame(rows).set_index(["round", "effect"]).sort_index()
    return rows.drop(columns="with_effects").astype(float), rows["with_effects"]


@pytest.mark.parametrize("which", ["report", "nothing"])
def test_json_follows_the_published_schema(which, request):
    schema = json.loads(files("skhyst.diagnosis").joinpath("report.schema.json").read_text())
    data = json.loads(request.getfixturevalue(which).to_json())
    validate(data, schema)
    for wrong in ({"verdict": "perhaps"}, {"error_after": None}, {"claims": [{"effect": "lag"}]}):
        with pytest.raises(ValidationError):
            validate(data | wrong, schema)


def test_json_is_finite_and_equals_the_search(report, search):
    data = finite_only(report.to_json())
    assert data == report.to_dict()
    assert data["effects"] == search.effects_ == ["resonance"]
    for name in ("verdict", "error_before", "error_after", "noise_floor", "seconds"):
        assert data[name] == getattr(search, f"{name}_")
    assert data["response_range"] == np.ptp(search.response_)
    assert data["command"] == COMMAND
    told, found = by_candidate(data["ranking"]), by_candidate(search.ranking_)
    pd.testing.assert_frame_equal(told[0], found[0])
    pd.testing.assert_series_equal(told[1], found[1])
    numbers = {r["name"]: (r["value"], r["std"], r["unit"]) for r in data["claims"][0]["numbers"]}
    for name, (value, std, unit) in search.evidence_["resonance"].numbers.items():
        assert numbers[name] == (value, None if math.isnan(std) else std, unit)
    values = np.concatenate([np.ravel(v) for v in search.best_estimator_.params_.values()])
    np.testing.assert_array_equal([r["value"] for r in data["parameters"]["augmented"]], values)


def test_a_notebook_shows_the_result_in_a_few_lines(search, report):
    assert len(repr(report)) < 1000
    assert report.headline in repr(report)
    (evidence,) = search.evidence_.values()
    assert len(repr(evidence)) < 2000
    for shown in (
        report._repr_html_(),
        search._repr_html_(),
        search._repr_mimebundle_()["text/html"],
    ):
        assert report.headline in shown
        assert "<b>resonance</b>" in shown
    assert len(report._repr_html_()) < 3000
    assert "EffectSearchCV" in search._repr_html_()
    assert "<b>resonance</b>" not in EffectSearchCV(search.estimator)._repr_html_()


def test_data_summary_counts(report, recording):
    data = report.to_dict()["data"]
    assert data["n_samples"] == len(recording.y_train)
    assert data["n_records"] == len(data["records"]) == 5
    assert sum(record["n_samples"] for record in data["records"]) == data["n_samples"]
    assert data["interval"] == pytest.approx(recording.sampling_interval)
    assert max(record["drive_max"] for record in data["records"]) == recording.X_train.values.max()


def test_not_it_holds_every_other_effect_once(report):
    names = [row["effect"] for row in report.not_it]
    assert sorted(names) == ["lag", "offset"]
    for row in report.not_it:
        tries = [r for r in report.ranking if r["effect"] == row["effect"]]
        contested = [
            r["error_after"] / r["error_before"] for r in tries if r["p_value"] is not None
        ]
        if contested:
            changes = [r["error_after"] / r["error_before"] - 1.0 for r in contested]
            assert row["change"] == pytest.approx(min(changes))
        else:
            assert row["screen"] == max(r["screen"] for r in tries)


def test_residual_spectra_carry_the_residuals_power(report, search):
    """The integral of a power density over frequency is the variance."""
    frequency = np.array(report.spectra["frequency"])
    for name, residual in (("before", search.residual_before_), ("after", search.residual_after_)):
        power = np.trapezoid(np.square(report.spectra[name]), frequency)
        assert 0.5 < power / np.nanvar(residual) < 1.5


def test_folds_hold_all_that_is_scored(report, search):
    n_samples = np.array([row["n_samples"] for row in report.folds])
    assert n_samples.sum() == report.data["n_scored"]
    for name in ("before", "after"):
        squares = np.square([row[f"error_{name}"] for row in report.folds])
        error = np.sqrt(np.average(squares, weights=n_samples))
        assert error == pytest.approx(getattr(search, f"error_{name}_"))


@pytest.mark.slow
def test_same_search_same_report(report, search, html):
    again = search.report(command=COMMAND)
    first, second = report.to_dict(), again.to_dict()
    assert first.pop("seconds").keys() == second.pop("seconds").keys()
    assert first == second
    assert Report(again.content | {"seconds": report.seconds}, again.displays).to_html() == html


# --------------------------------------------------------------------------------------- Markdown


def tables_are_whole(markdown):
    """Whether every row of every table has as many cells as its head."""
    lines = markdown.splitlines()
    tables = groupby(lines, lambda line: line.startswith("|"))
    widths = [{len(re.findall(r"(?<!\\)\|", r)) for r in rows} for is_one, rows in tables if is_one]
    return all(len(own) == 1 for own in widths)


def test_markdown_is_whole(markdown, report):
    assert markdown.startswith(f"# {report.headline}\n")
    assert tables_are_whole(markdown)
    assert markdown.count("\n|") > 20
    assert "<svg" not in markdown


# ------------------------------------------------------------------------------------------ files


@pytest.mark.parametrize("kind", ["html", "json", "markdown"])
def test_file_is_what_is_returned(nothing, tmp_path, kind):
    path, nothing = tmp_path / "übersicht.out", changed(nothing)
    content = getattr(nothing, f"to_{kind}")(path)
    assert path.read_text(encoding="utf-8") == content
    assert getattr(nothing, f"to_{kind}")(str(path)) == content
    with pytest.raises(FileNotFoundError, match="absent"):
        getattr(nothing, f"to_{kind}")(tmp_path / "absent" / "report")
    with pytest.raises(IsADirectoryError, match=re.escape(str(tmp_path))):
        getattr(nothing, f"to_{kind}")(tmp_path)


@pytest.mark.parametrize(
    ("module", "name", "without"),
    [("jinja2", "Jinja2", "to_json"), ("matplotlib.pyplot", "matplotlib", "to_markdown")],
)
def test_what_is_missing_names_the_extra(nothing, monkeypatch, module, name, without):
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(_report, "_template", _report._template.__wrapped__)  # which others had
    for form in {"to_html", "to_markdown"} - {without}:
        with pytest.raises(ImportError, match=rf"{name}.*skhyst\[plot\]"):
            getattr(nothing, form)()
    assert getattr(nothing, without)()
    summary, resolution, missing = nothing.to_text().splitlines()[:3]
    assert summary == nothing.summary
    assert resolution == f"resolution: {', '.join(nothing.resolution)}"
    assert missing == "missing: nothing"


def test_every_view_tells_the_same(report):
    claims = [claim | {"ambiguous_with": ["lag"], "provisional": True} for claim in report.claims]
    kept = {"n_samples": 7, "response_range": 1.0, "error_before": 0.2, "error_after": 0.1}
    failed = [{"round": 1, "effect": "offset", "error": "ValueError: no"}]
    resampled = report.data | {"resampling_error": 0.01 * report.response_range}
    suspect = {"effect": "lag", "error_before": 2.0, "error_after": 1.0, "p_value": 0.2}
    entries = {"suspects": [suspect], "warnings": ["A mode is at a bound."]}
    other = changed(report, claims=claims, held_out=kept, failed=failed, data=resampled, **entries)
    (statement,) = [claim["statement"] for claim in claims]
    errors = [number(own) for own in (other.error_before, other.error_after, other.noise_floor)]
    said = [
        statement,
        *errors,
        *other.remarks,
        "do not distinguish it from lag",
        "Provisional",
        "7 samples",
    ]
    views = other.to_text(), other.to_markdown().replace("\\", ""), Page(other.to_html()).text
    assert len(other.remarks) == 4
    assert "A mode is at a bound." in other.remarks
    assert any("not significant: lag" in remark for remark in other.remarks)
    for view in views:
        assert [own for own in said if own not in view.replace("\N{NO-BREAK SPACE}", " ")] == []
    summary, resolution, missing, law = other.to_text().splitlines()[:4]
    assert summary == other.summary
    assert resolution == f"resolution: {', '.join(report.resolution)}"
    assert missing == "missing: resonance"
    assert law.startswith("  resonance: ")
    again = Report({**json.loads(other.to_json())})
    assert again.to_markdown() == other.to_markdown()


def test_what_is_no_entry_is_no_attribute(report):
    assert "noise_floor" in dir(report)
    assert copy.deepcopy(report).to_dict() == report.to_dict()
    with pytest.raises(AttributeError, match="'nothing'"):
        report.nothing  # noqa: B018


# ---------------------------------------------------------------------------------------- numbers

SUPERSCRIPT = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def parsed(text):
    """Read a number back."""
    mantissa, _, power = text.replace("−", "-").partition(" × 10")
    return float(mantissa) * 10.0 ** (int(power.translate(SUPERSCRIPT)) if power else 0)


finite = st.floats(1e-200, 1e200) | st.floats(-1e200, -1e-200)


@given(finite, st.integers(1, 8))
@settings(deadline=None, max_examples=200)
def test_a_number_reads_back(value, digits):
    assert parsed(number(value, digits)) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))


@given(finite, st.floats(1e-6, 10.0))
@settings(deadline=None, max_examples=200)
def test_a_value_reads_back_within_its_error(value, relative):
    std = abs(value) * relative
    text = plus_minus(value, std)
    inner, power = re.fullmatch(r"\(?([^()]*)\)?( × 10.*)?", text).groups()
    shown, error = (parsed(part + (power or "")) for part in inner.split(" ± "))
    assert shown == pytest.approx(value, abs=0.1 * std)
    assert error == pytest.approx(std, rel=0.06)


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_no_number_is_a_dash(value):
    assert number(value) == plus_minus(value, 1.0) == "–"


def test_what_to_beware_of_comes_first(report):
    plain = report.sentence
    beyond = changed(report, error_after=2.0 * report.response_range)
    assert beyond.sentence.startswith("A held-out error of ")
    assert "200 %" in beyond.sentence.split(": ")[0]
    far = changed(report, data=report.data | {"extrapolated": 0.2})
    assert far.sentence == f"{far.sentence[: -len(plain)]}{plain}"
    assert far.sentence.startswith("The folds extrapolate: 20 % of the samples")
    assert not plain.startswith("The folds") or report.data["extrapolated"] > 0.05


def test_a_model_that_explains_far_more_is_told_first(search, report):
    """Three times is far, and what was found may make up for it."""
    names = ["gain", "stage", "broken"]  # the fit of the last one has failed
    errors = [report.error_before, 0.5 * report.error_after, math.nan]
    rows = {"about": "a device", "single": True, "error": errors, "n_parameters": 3}
    table = pd.DataFrame(rows, index=names)
    comparison = ModelComparisonDisplay(table, "stage", None, report.response_range)
    far = Report.from_search(search, comparison=comparison)
    told = "Another model explains far more: stage (a device)"
    assert far.sentence.startswith(told)
    assert far.to_text().startswith(told)
    assert far.to_dict()["comparison"]["taken"] == "stage"
    assert "models" in far.displays
    view = changed(far)  # without pictures
    assert "Models that were compared" in Page(view.to_html()).text
    assert tables_are_whole(view.to_markdown())
    for error in (0.5 * report.error_before, report.error_after):
        models = [own | {"error": error} for own in far.comparison["models"]]
        near = changed(far, comparison=far.comparison | {"models": models})
        assert near.sentence == report.sentence


def test_the_summary_says_what_is_missing_how_sure_and_what_next(report, nothing):
    part = 100.0 * (1.0 - (report.error_after / report.error_before) ** 2)
    settled = changed(report, next_steps=[])
    assert settled.summary == (
        f"The model lacks resonance: it explains {part:#.3g} % of the power of its held-out "
        "error. Sure: where nothing is missing, at most 1 % of searches claim an effect. The "
        "residual is noise. Next: nothing more to record."
    )
    unsure = changed(report, **ambiguous(report), next_steps=["a", "b"])
    assert "resonance may be lag instead. " in unsure.summary
    assert unsure.summary.endswith("Next: the 2 steps below.")
    assert (
        "but not which effect. The residual still has structure"
        in changed(report, **provisional(report)).summary
    )
    assert nothing.summary.startswith("No missing effect was found")
    lost = changed(nothing, verdict="undetermined", error_before=0.0, error_after=0.0)
    assert lost.summary.startswith("This recording does not show whether an effect is missing.")
    faults = [{"fault": kind} for kind in ("outlier", "lost_rows", "outlier")]
    wrong = changed(nothing, data=nothing.data | {"faults": faults})
    assert "faults, which may be the cause: outlier. " in wrong.summary


def test_the_noise_is_told(report):
    assert report.noise_model["text"] in report.to_markdown().replace("\\", "")
    assert report.to_dict()["noise_model"]["law"] in ("white", "autoregressive", "power_law")
