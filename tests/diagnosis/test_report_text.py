"""How a report writes numbers, and what it says where there is nothing to draw."""

import dataclasses
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._report_text import number, plus_minus
from skhyst.hysteresis import PrandtlIshlinskii

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


@pytest.fixture(scope="module")
def exact():
    """The report of a search on data that the declared model reproduces to rounding."""
    drive = np.cumsum(np.random.default_rng(0).normal(size=600))
    model = PrandtlIshlinskii(3)
    response = model.fit(drive[:, None], 2.0 * drive).predict(drive[:, None])
    search = EffectSearchCV(PrandtlIshlinskii(3), effects=["lag"], random_state=0)
    return search.fit(drive[:, None], response).report()


def test_nothing_was_tried(exact):
    assert exact.ranking == []
    assert "No effect was tried" in exact.to_html()
    assert exact.to_dict()["not_it"] == []
    assert exact.to_markdown().startswith("# Nothing is missing")


def test_nothing_was_contested(exact):
    row = {
        "round": 1,
        "effect": "lag",
        "screen": 1e-5,
        "error_before": 1.0,
        "error_after": math.nan,
        "p_value": math.nan,
        "n_parameters": 1,
        "claimed": False,
    }
    page = dataclasses.replace(exact, ranking=[row]).to_html()
    assert "No candidate explains enough to be contested." in page
    assert "&lt; 0.1 %" in page
    assert 'aria-label="Round 1"' not in page
