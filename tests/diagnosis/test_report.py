"""The report: the numbers of the search, on a page that needs nothing and runs nothing."""

import dataclasses
import json
import math
import re
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
from plants import make_recording
from sklearn.base import clone

from skhyst.diagnosis import EffectSearchCV, Report, _report_figures
from skhyst.diagnosis._report_text import next_steps, number, plus_minus
from skhyst.hysteresis import PrandtlIshlinskii

HOSTILE = "<script>alert(1)</script>"
COMMAND = 'skhyst diagnose "a b.csv" --drive <x> & more'


@pytest.fixture(scope="module")
def recording():
    return make_recording("resonance", "prandtl_ishlinskii", 3, n_samples=4000)


@pytest.fixture(scope="module")
def search(recording):
    return EffectSearchCV(
        PrandtlIshlinskii(), effects=["resonance", "lag", "offset"], random_state=0
    ).fit(recording.X_train, recording.y_train)


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
    search = EffectSearchCV(PrandtlIshlinskii(), effects=["lag", "offset"], random_state=0)
    return search.fit(X, recording.y_train).report(command=HOSTILE)


@pytest.fixture
def no_pictures(monkeypatch):
    """Pages without pictures, for tests that are about words."""

    def figures(report):
        lists = {"rankings": [""] * len(report.rounds), "evidence": [""] * len(report.claims)}
        return {"loops": "", "residuals": "", **lists}

    monkeypatch.setattr(_report_figures, "report_figures", figures)


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
        elif "svg" not in self._open:
            self._text.append(data)


def assert_needs_nothing(html):
    page = Page(html)
    forbidden = {"script", "link", "iframe", "object", "embed", "base", "img", "form", "video"}
    assert not page.tags & forbidden
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
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def leaves(value):
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from leaves(item)
    else:
        yield value


def either(value):
    return None if math.isnan(value) else value


# ------------------------------------------------------------------------------------------ page


def test_page_needs_nothing_and_runs_nothing(html):
    page = assert_needs_nothing(html)
    assert "svg" in page.tags
    policies = [value for tag, _, value in page.attributes if tag == "meta" and "-src" in value]
    assert policies == ["default-src 'none'; style-src 'unsafe-inline'"]


def test_page_tells_in_order(html, report):
    (claim,) = report.claims
    assert claim["effect"] == "resonance"
    page = " ".join(html.replace("&#39;", "'").split())
    landmarks = [
        f"<h1>{report.headline}</h1>",
        report.sentence,
        'aria-label="Loops',
        'aria-label="Residuals',
        'aria-label="Round 1"',
        claim["statement"],
        'aria-label="Evidence for resonance"',
        "<h2>What it was not</h2>",
        "<h2>Parameters</h2>",
        "skhyst diagnose",
    ]
    places = [page.index(mark) for mark in landmarks]
    assert places == sorted(places)


def test_sentence_carries_the_errors(report):
    for error in (report.error_before, report.error_after, report.noise_floor):
        assert number(error) in report.sentence
        assert f"{number(100 * error / report.response_range)} %" in report.sentence
    assert report.declared_model in report.sentence
    assert "resonance" in report.sentence


def test_page_shows_every_number_with_its_error(html, markdown, report):
    text = Page(html).text
    for row in report.claims[0]["numbers"]:
        shown = plus_minus(row["value"], row["std"])
        assert "±" in shown
        assert shown in text
        assert shown in markdown
    for row in report.ranking:
        if math.isfinite(row["error_after"]):
            assert number(row["error_after"]) in text
    for row in report.not_it:
        assert row["effect"] in text
    for name, version in report.versions.items():
        assert name in text
        assert version in text
    assert COMMAND in text


def test_page_has_all_fitted_parameters(html, search, report):
    text = Page(html).text
    for rows, estimator in (
        (report.parameters["declared"], search.declared_estimator_),
        (report.parameters["augmented"], search.best_estimator_),
    ):
        assert sum(np.size(value) for value in estimator.params_.values()) == len(rows)
        for row in rows:
            if math.isfinite(row["std"]):
                assert plus_minus(row["value"], row["std"]) in text


def test_column_that_wants_to_be_a_script(nothing):
    assert nothing.drive_name == HOSTILE
    html = nothing.to_html()
    page = assert_needs_nothing(html)
    assert HOSTILE in page.text
    assert HOSTILE not in html
    prose = [line for line in nothing.to_markdown().splitlines() if not line.startswith("    ")]
    assert "<script" not in re.sub(r"\\.", "", "\n".join(prose))  # indented lines are code
    assert json.loads(nothing.to_json())["drive_name"] == HOSTILE


@pytest.mark.parametrize("name", [r"a$b$ $\nope{ ], |*`_", "line\nbreak", "x" * 300])
def test_any_column_name_is_drawn(nothing, name):
    signals = {**nothing.signals, "drive_name": name, "response_name": name}
    named = dataclasses.replace(nothing, drive_name=name, response_name=name, signals=signals)
    assert_needs_nothing(named.to_html())
    assert tables_are_whole(named.to_markdown())


# --------------------------------------------------------------------------------------- verdicts


def test_nothing_missing_is_said(no_pictures, nothing):
    assert nothing.effects == []
    assert nothing.verdict == "noise"
    assert nothing.headline == "Nothing is missing"
    assert number(nothing.error_before) in nothing.sentence
    for text in (Page(nothing.to_html()).text, nothing.to_markdown()):
        assert "Nothing is missing" in text
        assert "nexplained" not in text


def test_unexplained_is_said(no_pictures, nothing):
    unexplained = dataclasses.replace(
        nothing, verdict="unexplained", noise_floor=0.4 * nothing.error_before
    )
    assert unexplained.headline == "Unexplained"
    assert number(unexplained.noise_floor) in unexplained.sentence
    for text in (Page(unexplained.to_html()).text, unexplained.to_markdown()):
        assert "Unexplained" in text
        assert "No effect is claimed" in text
        assert "Nothing is missing" not in text


def test_claim_and_unexplained_rest(no_pictures, report):
    rest = dataclasses.replace(report, verdict="unexplained")
    assert "resonance" in rest.headline
    for text in (Page(rest.to_html()).text, rest.to_markdown()):
        assert "nexplained" in text


def test_ambiguity_and_its_experiment_are_said(no_pictures, report):
    claim = {**report.claims[0], "ambiguous_with": ["lag"], "experiment": "Ring it, then listen."}
    ambiguous = dataclasses.replace(report, claims=[claim])
    for text in (Page(ambiguous.to_html()).text, ambiguous.to_markdown()):
        assert re.search(r"cannot tell[^.]*\blag\b", text)
        assert "Ring it, then listen." in text


def test_what_was_dropped_is_said(no_pictures, report):
    dropped = dataclasses.replace(report, dropped=["my_lag"])
    for text in (Page(dropped.to_html()).text, dropped.to_markdown().replace("\\", "")):
        assert "my_lag had been claimed first, and was dropped" in text
    assert "dropped" not in Page(report.to_html()).text


def test_law_and_look_of_the_residual_are_told(no_pictures, report):
    (claim,) = report.claims
    place = next(row for row in report.declared_location if row["by"] == "frequency")
    frequency = next(r["value"] for r in claim["numbers"] if r["name"] == "natural frequency")
    assert place["low"] / 2.0 < frequency < 2.0 * place["high"]
    for text in (Page(report.to_html()).text, report.to_markdown()):
        assert claim["law"] in text
        assert "What the declared model leaves is strongest" in text


def test_what_to_measure_next():
    claim = {"effect": "lag", "ambiguous_with": ["delay"], "experiment": "Sweep."}
    miss = {"effect": "creep", "p_value": 0.2, "change": -0.1, "claimed_instead": None}
    place = {"by": "frequency", "record": None, "low": 1.0, "high": 2.0, "concentration": 3.0}
    fault = {"fault": "outliers"}

    def steps(claims=(), not_it=(), location=(), verdict="noise", faults=()):
        return next_steps(claims, not_it, location, verdict, faults, 0.01, {"creep": "Rest."})

    assert steps() == []
    assert steps([claim]) == ["To tell lag from delay: Sweep."]
    assert steps([claim | {"ambiguous_with": []}]) == []
    (step,) = steps(not_it=[miss, miss | {"change": -0.01}, miss | {"p_value": np.nan}])
    assert step.startswith("creep would make the error 10 % smaller")
    assert step.endswith("Rest.")
    assert "from 1.00 to 2.00 Hz" in steps(location=[place], verdict="unexplained")[0]
    assert "repeat one record" in steps(verdict="unexplained")[0]
    assert len(steps([claim], [miss], [place], "unexplained", [fault])) == 4


def test_held_out_data_are_reported(search, recording):
    kept = (recording.X_test, recording.y_test)
    report = Report.from_search(search, held_out=kept)
    before = search.held_out_error(*kept, declared=True)
    after = search.held_out_error(*kept)
    assert report.held_out["error_before"] == before
    assert report.held_out["error_after"] == after
    assert report.held_out["n_samples"] == len(recording.y_test)
    text = report.to_markdown()
    assert number(before) in text
    assert number(after) in text


# ------------------------------------------------------------------------------------------- data


def test_json_is_finite_and_equals_the_search(report, search):
    data = finite_only(report.to_json())
    assert all(math.isfinite(v) for v in leaves(data) if isinstance(v, float))
    assert data["effects"] == search.effects_ == ["resonance"]
    assert data["verdict"] == search.verdict_
    for name in ("error_before", "error_after", "noise_floor"):
        assert data[name] == getattr(search, f"{name}_")
    assert data["response_range"] == np.ptp(search.response_)
    assert data["command"] == COMMAND
    found = {(row["round"], row["effect"]): row for row in data["ranking"]}
    assert len(found) == len(search.ranking_)
    for row in search.ranking_.itertuples():
        kept = found[row.round, row.effect]
        assert kept["screen"] == row.screen
        assert kept["error_before"] == row.error_before
        assert kept["error_after"] == either(row.error_after)
        assert kept["p_value"] == either(row.p_value)
        assert kept["n_parameters"] == row.n_parameters
        assert kept["claimed"] == row.claimed
    numbers = {row["name"]: row for row in data["claims"][0]["numbers"]}
    for name, (value, std, unit) in search.evidence_["resonance"].numbers.items():
        expected = {"value": value, "std": either(std), "unit": unit}
        assert {key: numbers[name][key] for key in expected} == expected
    values = np.concatenate([np.ravel(v) for v in search.best_estimator_.params_.values()])
    np.testing.assert_array_equal([r["value"] for r in data["parameters"]["augmented"]], values)
    assert data["seconds"] == search.seconds_


def test_dictionary_is_the_json(report):
    assert finite_only(report.to_json()) == report.to_dict()
    assert "signals" not in report.to_dict()


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
        contested = [r["error_after"] / r["error_before"] for r in tries if r["p_value"] >= 0]
        if contested:
            assert row["change"] == pytest.approx(min(contested) - 1.0)
        else:
            assert row["screen"] == max(r["screen"] for r in tries)


def test_residual_spectra_carry_the_residuals_power(report, search):
    """The integral of a power density over frequency is the variance."""
    frequency = np.array(report.spectra["frequency"])
    for name, residual in (("before", search.residual_before_), ("after", search.residual_after_)):
        power = np.trapezoid(np.square(report.spectra[name]), frequency)
        assert 0.5 < power / np.nanvar(residual) < 1.5


def test_same_search_same_report(report, search, recording, html):
    again = clone(search).fit(recording.X_train, recording.y_train).report(command=COMMAND)
    first, second = report.to_dict(), again.to_dict()
    assert first.pop("seconds").keys() == second.pop("seconds").keys()
    assert first == second
    assert dataclasses.replace(again, seconds=report.seconds).to_html() == html


# --------------------------------------------------------------------------------------- Markdown


def tables_are_whole(markdown):
    """Whether every row of every table has as many cells as its head."""
    width = 0
    for line in markdown.splitlines():
        if not line.startswith("|"):
            width = 0
            continue
        cells = len(re.findall(r"(?<!\\)\|", line))
        if width not in (0, cells):
            return False
        width = cells
    return True


def test_markdown_is_whole(markdown, report):
    assert markdown.startswith(f"# {report.headline}\n")
    assert tables_are_whole(markdown)
    assert markdown.count("\n|") > 20
    assert "<svg" not in markdown
    for row in report.ranking:
        assert f"| {row['effect']} |" in markdown
    for row in report.parameters["augmented"]:
        if math.isfinite(row["std"]):
            assert plus_minus(row["value"], row["std"]) in markdown


# ------------------------------------------------------------------------------------------ files


@pytest.mark.parametrize("kind", ["html", "json", "markdown"])
def test_file_is_what_is_returned(no_pictures, nothing, tmp_path, kind):
    path = tmp_path / "übersicht.out"
    content = getattr(nothing, f"to_{kind}")(path)
    assert path.read_text(encoding="utf-8") == content
    assert getattr(nothing, f"to_{kind}")(str(path)) == content


@pytest.mark.parametrize("kind", ["html", "json", "markdown"])
def test_unwritable_path_is_named(no_pictures, nothing, tmp_path, kind):
    with pytest.raises(FileNotFoundError, match="absent"):
        getattr(nothing, f"to_{kind}")(tmp_path / "absent" / "report")
    with pytest.raises(IsADirectoryError, match=re.escape(str(tmp_path))):
        getattr(nothing, f"to_{kind}")(tmp_path)


def test_missing_jinja_names_the_extra(nothing, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    for write in (nothing.to_html, nothing.to_markdown):
        with pytest.raises(ImportError, match=r"Jinja2.*skhyst\[plot\]"):
            write()
    assert finite_only(nothing.to_json())["verdict"] == "noise"


def test_missing_matplotlib_names_the_extra(nothing, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ImportError, match=r"matplotlib.*skhyst\[plot\]"):
        nothing.to_html()
    assert nothing.to_markdown()
