"""Words and numbers of a report: how a value, its error and a verdict are written."""

import math
import re

__all__ = [
    "change",
    "explain_units",
    "folded",
    "listed",
    "looks",
    "next_steps",
    "number",
    "percent",
    "plus_minus",
    "quantity",
    "share",
    "unit_of",
    "verdict",
]

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value, digits=3):
    """Write a number with so many significant digits; a dash where there is none.

    Examples
    --------
    >>> number(0.04125), number(123456.0), number(3.2e-7), number(float("nan"))
    ('0.0413', '123456', '3.20 × 10⁻⁷', '–')
    """
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 <= exponent < 7:
        return _signed(f"{value:.{max(digits - 1 - exponent, 0)}f}")
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    return f"{_signed(mantissa)} × 10{str(int(power)).translate(_SUPERSCRIPT)}"


def plus_minus(value, std):
    """Write a value with its standard error, two significant digits of the error.

    Examples
    --------
    >>> plus_minus(0.60132, 0.0041), plus_minus(1234.5, 21.0), plus_minus(2.0, float("nan"))
    ('0.6013 ± 0.0041', '1234 ± 21', '2.000')
    >>> plus_minus(3.14159e-7, 2.1e-9)
    '(3.142 ± 0.021) × 10⁻⁷'
    """
    if value is None or not math.isfinite(value):
        return "–"
    if std is None or not math.isfinite(std) or std <= 0:
        return number(value, 4)
    exponent = math.floor(math.log10(max(abs(value), std)))
    scale = exponent if not -4 <= exponent < 7 else 0
    value, std = value / 10.0**scale, std / 10.0**scale
    decimals = min(max(0, 1 - math.floor(math.log10(std))), 12)
    text = f"{_signed(f'{value:.{decimals}f}')} ± {std:.{decimals}f}"
    return f"({text}) × 10{str(scale).translate(_SUPERSCRIPT)}" if scale else text


def _signed(text):
    """Write a minus sign for a hyphen."""
    return text.replace("-", "−")


def share(value):
    """Write a part of one as a percentage, roughly.

    Examples
    --------
    >>> share(0.9234), share(0.0341), share(2e-9), share(0.0)
    ('92 %', '3.4 %', '< 0.1 %', '< 0.1 %')
    """
    return f"{number(100.0 * value, 2)} %" if value >= 0.001 else "< 0.1 %"


def percent(value, whole):
    """Write a value as a percentage of another.

    Examples
    --------
    >>> percent(0.0231, 1.0), percent(1.0, 0.0)
    ('2.31 %', '–')
    """
    return f"{number(100.0 * value / whole)} %" if whole else "–"


def change(before, after):
    """Write by how much an error has changed.

    Examples
    --------
    >>> change(2.0, 0.5), change(2.0, 2.1), change(2.0, 2.0001), change(2.0, 30.0)
    ('−75.0 %', '+5.0 %', '0.0 %', '15 times')
    >>> change(0.0, 1.0)
    '–'
    """
    if not before or not math.isfinite(after):
        return "–"
    if after > 3.0 * before:
        return f"{number(after / before, 2)} times"
    text = f"{100.0 * (after / before - 1.0):+.1f} %"
    return "0.0 %" if text[1:] == "0.0 %" else _signed(text)


def unit_of(name):
    """Return the unit that a column's name carries in brackets, or "".

    Examples
    --------
    >>> unit_of("voltage (V)"), unit_of("x [um]"), unit_of("speed"), unit_of("gauge[0]")
    ('V', 'um', '', '')
    """
    found = re.search(r"[(\[](?!\d+[)\]])([^()\[\]]{1,12})[)\]]\s*$", str(name))
    return found.group(1).strip() if found else ""


def explain_units(unit, drive_unit, response_unit):
    """Put the units of the columns into a unit given in terms of drive and response.

    Examples
    --------
    >>> explain_units("response/drive", "V", "um"), explain_units("1/s", "", "")
    ('um/V', '1/s')
    """
    if drive_unit:
        unit = re.sub(r"\bdrive\b", lambda _: drive_unit, unit)
    if response_unit:
        unit = re.sub(r"\bresponse\b", lambda _: response_unit, unit)
    return unit


def quantity(value, unit, whole):
    """Write an error in its unit, with its percentage of the range.

    Examples
    --------
    >>> quantity(0.0412, "um", 2.0)
    '0.0412 um (2.06 % of the range)'
    """
    return f"{number(value)}{' ' + unit if unit else ''} ({percent(value, whole)} of the range)"


def listed(names):
    """Join names.

    Examples
    --------
    >>> listed(["a"]), listed("ab"), listed("abc")
    ('a', 'a and b', 'a, b and c')
    """
    names = [str(name) for name in names]
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def _with_others(claim):
    """Return a claimed effect with the effects that fit as well."""
    others = claim["ambiguous_with"]
    told = f" (these data cannot tell it from {listed(others)})" if others else ""
    return claim["effect"] + told


def folded(rows):
    """Join rows of parameters that stand next to each other in one vector, all 0 and at a bound.

    Examples
    --------
    >>> rows = [{"name": f"weights[{k}]", "value": v, "std": s, "note": n}
    ...         for k, (v, s, n) in enumerate([(2.0, 0.1, ""), (0.0, None, "at a bound"),
    ...                                        (0.0, None, "at a bound")])]
    >>> [row["name"] for row in folded(rows)]
    ['weights[0]', 'weights[1–2]']
    """
    joined = []
    for row in rows:
        last = joined[-1] if joined else None
        same = (
            last is not None
            and row["value"] == last["value"] == 0.0
            and row["note"] == last["note"] != ""
            and row["name"].partition("[")[0] == last["name"].partition("[")[0]
            and "[" in row["name"]
        )
        if same:
            first = last["name"].rstrip("]").partition("–")[0]
            joined[-1] = {**row, "name": f"{first}–{row['name'].partition('[')[2]}"}
        else:
            joined.append(row)
    return joined


_PLACES = {
    "record": "in record {record}",
    "time": "from {low} to {high} s of record {record}",
    "drive": "where the drive is from {low} to {high}",
    "rate": "where the drive's rate is from {low} to {high}",
    "frequency": "from {low} to {high} Hz",
}
_NEAR_MISSES = 2


def looks(location):
    """Say where a residual stands.

    Examples
    --------
    >>> row = {"by": "frequency", "record": None, "low": 10.0, "high": 20.0, "concentration": 4.0}
    >>> looks([row]), looks([])
    ('from 10.0 to 20.0 Hz (4.0 times the mean power)', '')
    """
    return "; ".join(
        _PLACES[row["by"]].format(
            record=row["record"], low=number(row["low"]), high=number(row["high"])
        )
        + f" ({number(row['concentration'], 2)} times the mean power)"
        for row in location
    )


def next_steps(claims, not_it, location, verdict, faults, alpha, experiments):
    """Return what to measure next, a list of sentences.

    Parameters
    ----------
    claims, not_it, location, faults : list of dict
        Of a report.
    verdict : str
    alpha : float
    experiments : dict of str to str
        The experiment that shows each effect best.
    """
    steps = []
    for claim in claims:
        others = claim["ambiguous_with"]
        if others:
            steps.append(f"To tell {claim['effect']} from {listed(others)}: {claim['experiment']}")
    misses = [
        row
        for row in not_it
        if row["p_value"] >= alpha and row["change"] < -0.05 and row["claimed_instead"] is None
    ]
    for row in misses[:_NEAR_MISSES]:
        steps.append(
            f"{row['effect']} would make the error {number(-100.0 * row['change'], 2)} % smaller, "
            f"which these records do not make certain (p = {number(row['p_value'], 2)}). To see "
            f"whether it is there: {experiments.get(row['effect'], '')}".rstrip()
        )
    if verdict == "unexplained":
        where = looks(location)
        steps.append(
            "Record more of what no effect explains"
            + (
                f": it is strongest {where}."
                if where
                else ", and repeat one record exactly: what "
                "returns is structure, what does not is noise."
            )
        )
    if faults:
        steps.append("Mend the faults of the recording listed under Data, and search again.")
    return steps


def verdict(report):
    """Return the headline and the sentence that says what a search found.

    Parameters
    ----------
    report : Report

    Returns
    -------
    headline, sentence : str
    """
    unit = unit_of(report.response_name)
    before, after, floor = (
        quantity(value, unit, report.response_range)
        for value in (report.error_before, report.error_after, report.noise_floor)
    )
    explained = report.verdict == "noise"
    if report.effects:
        found = listed(_with_others(claim) for claim in report.claims)
        headline = f"Missing: {', '.join(report.effects)}"
        sentence = (
            f"The declared model {report.declared_model} lacks {found}: with "
            f"{'it' if len(report.effects) == 1 else 'them'} the held-out error falls from "
            f"{before} to {after}"
        )
        if explained:
            return headline, f"{sentence}. What is left is noise; its floor is {floor}."
        return (
            f"{headline}; and something unexplained",
            f"{sentence}. What is left is still above the noise floor of {floor}, and no effect "
            "that was tried explains it.",
        )
    if explained:
        return (
            "Nothing is missing",
            f"The declared model {report.declared_model} lacks none of the effects that were "
            f"tried: its held-out error is {before}. What is left is noise; its floor is {floor}.",
        )
    return (
        "Unexplained",
        f"The declared model {report.declared_model} leaves structure that none of the effects "
        f"that were tried explains: its held-out error is {before}, above the noise floor of "
        f"{floor}. No effect is claimed.",
    )
