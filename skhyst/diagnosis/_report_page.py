"""The text of a report: blocks that a template writes as HTML or as Markdown."""

import math

from ._report_data import looks
from ._report_text import change, in_words, listed, number, percent, plus_minus, share, unit_of

__all__ = ["page", "verdict"]

_MANY = 24  # rows of parameters that a page shows unfolded


def verdict(report):
    """Return the headline and the sentence that says what a search found."""
    before, after, floor = (
        _error(report, value)
        for value in (report.error_before, report.error_after, report.noise_floor)
    )
    noise = f"What is left is noise; its floor is {floor}."
    model = f"The declared model {report.declared_model}"
    explained = report.verdict == "noise"
    if report.effects:
        found = listed(
            claim["effect"]
            + (
                f" (these data cannot tell it from {listed(claim['ambiguous_with'])})"
                if claim["ambiguous_with"]
                else ""
            )
            for claim in report.claims
        )
        them = "it" if len(report.effects) == 1 else "them"
        rest = f"What is left is still above the noise floor of {floor}, and no effect that was"
        return (
            f"Missing: {', '.join(report.effects)}"
            + ("" if explained else "; and something unexplained"),
            f"{model} lacks {found}: with {them} the held-out error falls from {before} to "
            f"{after}. {noise if explained else f'{rest} tried explains it.'}",
        )
    if explained:
        return "Nothing is missing", (
            f"{model} lacks none of the effects that were tried: its held-out error is {before}. "
            f"{noise}"
        )
    return "Unexplained", (
        f"{model} leaves structure that none of the effects that were tried explains: its "
        f"held-out error is {before}, above the noise floor of {floor}. No effect is claimed."
    )


def page(report, figures=None):
    """Return the blocks of a report, from top to bottom: dicts with a ``kind``.

    Parameters
    ----------
    report : Report
    figures : dict, optional
        Of :func:`report_figures`; none in a text.
    """
    figures = figures or {
        "rankings": [""] * len(report.rounds),
        "evidence": [""] * len(report.claims),
    }
    return [
        block
        for part in (
            _head(report),
            _signals(report, figures),
            _candidates(report, figures["rankings"]),
            _claims(report, figures["evidence"]),
            _not_it(report),
            _next(report),
            _parameters(report),
            _data(report),
            _origin(report),
        )
        for block in part
        if block is not None
    ]


def _heading(text, level=2):
    return {"kind": "heading", "text": text, "level": level}


def _text(text, style=""):
    return {"kind": "text", "text": text, "style": style}


def _figure(svg, caption=""):
    return {"kind": "figure", "svg": svg, "text": caption} if svg else None


def _table(head, align, rows, folded=""):
    """Return a table; ``align`` has a letter a column, ``rows`` are (style, cells)."""
    return {"kind": "table", "head": head, "align": align, "rows": rows, "folded": folded}


def _error(report, value, whole=None):
    """Write an error in its unit, with its percentage of the range."""
    unit = unit_of(report.response_name)
    part = percent(value, report.response_range if whole is None else whole)
    return f"{number(value)}{' ' + unit if unit else ''} ({part} of the range)"


def _unit(report, unit):
    return in_words(unit, unit_of(report.drive_name), unit_of(report.response_name))


def _head(report):
    unit, kept = unit_of(report.response_name), report.held_out
    errors = [("declared model", "before", report.error_before)]
    if report.effects:
        errors.append(("with what was found", "after", report.error_after))
    errors.append(("noise floor", "floor", report.noise_floor))
    top = max(value for *_, value in errors)
    yield _text(report.sentence, "lead")
    yield {
        "kind": "bars",
        "head": ["error (RMS, held out)", unit or "value", "of the range"],
        "rows": [
            (
                style,
                100.0 * value / top if top and math.isfinite(value) else 0.0,
                [name, number(value), percent(value, report.response_range)],
            )
            for name, style, value in errors
        ],
    }
    if kept:
        whole = kept["response_range"]
        after = f", {_error(report, kept['error_after'], whole)} after" if report.effects else ""
        yield _text(
            f"On {kept['n_samples']} samples kept from the search altogether: "
            f"{_error(report, kept['error_before'], whole)} before{after}."
        )


def _signals(report, figures):
    if "loops" in figures:
        yield _heading("Loops and residuals")
        models = "declared model" + (" (left) and with what was found" if report.effects else "")
        yield _figure(
            figures["loops"],
            f"Measured response against drive, with the {models}, as predicted for samples not "
            "seen in fitting. Below, less the straight line through the measured points.",
        )
        yield _figure(
            figures["residuals"],
            "Measured minus predicted. Lines in the branch pictures are means, bands one standard "
            "deviation; the dotted line is white noise of the size of the noise floor.",
        )
    if report.declared_location:
        place = looks(report.declared_location)
        yield _text(f"What the declared model leaves is strongest {place}.")


def _candidates(report, figures):
    yield _heading("Candidates")
    for figure, round in zip(figures, report.rounds, strict=True):
        rows = [row for row in report.ranking if row["round"] == round]
        winners = [row["effect"] for row in rows if row["claimed"]]
        claimed = f"{', '.join(winners)} claimed" if winners else "nothing claimed"
        yield _heading(f"Round {round}: {claimed}", 3)
        yield _figure(figure)
        if not any(math.isfinite(row["error_after"]) for row in rows):
            yield _text("No candidate explains enough to be contested.")
        yield _table(
            ["effect", "explains", "error", "change", "p", "parameters", ""],
            "lrrrrrl",
            [_candidate(row) for row in rows],
        )
        if len(winners) > 1:
            yield _text("Neither of the two qualifies alone; together they do.")
    if report.rounds:
        yield _text(
            "“Explains” is the share of the residual's power that the effect removes when it is "
            "put into the model and fitted briefly; only the best are contested on held-out data. "
            "p is corrected for the number of candidates; an effect is claimed below "
            f"{report.settings['alpha']}.",
            "quiet",
        )
    else:
        yield _text("No effect was tried: the declared model leaves nothing.")


def _candidate(row):
    first, last = [row["effect"], share(row["screen"])], str(row["n_parameters"])
    if not math.isfinite(row["error_after"]):
        return "faint", [*first, "–", "–", "–", last, "not contested"]
    moved = change(row["error_before"], row["error_after"])
    cells = [*first, number(row["error_after"]), moved, number(row["p_value"], 2), last]
    return ("claimed", [*cells, "claimed"]) if row["claimed"] else ("", [*cells, ""])


def _claims(report, figures):
    yield _heading("What is missing, and why we say so")
    for place, (claim, figure) in enumerate(zip(report.claims, figures, strict=True), start=1):
        yield _heading(f"{place}. {claim['effect']}", 3)
        yield _text(claim["statement"])
        yield _text(
            f"With it, the held-out error goes from {_error(report, claim['error_before'])} to "
            f"{_error(report, claim['error_after'])}, p = {number(claim['p_value'], 2)}."
        )
        if claim["numbers"]:
            rows = [
                ("", [row["name"], plus_minus(row["value"], row["std"]), row["unit"]])
                for row in claim["numbers"]
            ]
            yield _table(["number", "value ± standard error", "unit"], "lrl", rows)
        yield _figure(figure)
        others, told = claim["ambiguous_with"], claim["experiment"]
        if others:
            told = (
                f"These data cannot tell {claim['effect']} from {listed(others)}. The simplest is "
                f"named. {told and f'To tell: {told}'}"
            )
        if told:
            yield _text(told, "note")
    if not report.claims:
        at = "it is already at" if report.verdict == "noise" else "something is left above"
        first = "Nothing is missing" if report.verdict == "noise" else "No effect is claimed"
        yield _text(
            f"{first}: none of the effects that were tried makes the held-out error significantly "
            f"smaller, and {at} the noise floor."
        )
    yield from _what_is_left(report)


def _what_is_left(report):
    if report.dropped:
        was, it = ("was", "it") if len(report.dropped) == 1 else ("were", "them")
        yield _text(
            f"{listed(report.dropped)} had been claimed first, and {was} dropped: later claims "
            f"made {it} needless."
        )
    if report.verdict != "unexplained":
        return
    if report.claims:
        yield _text(
            "Something unexplained remains: the error is still above the noise floor, and no "
            "further effect makes it significantly smaller.",
            "note",
        )
    if report.location:
        yield _text("What is left is strongest here:")
        rows = [
            (
                "",
                [
                    row["by"],
                    row["record"] or "all",
                    number(row["low"]),
                    number(row["high"]),
                    _unit(report, row["unit"]),
                    share(row["share"]),
                    number(row["concentration"], 2),
                ],
            )
            for row in report.location
        ]
        head = ["by", "record", "from", "to", "unit", "share of its power", "times the mean"]
        yield _table(head, "llrrlrr", rows)


def _not_it(report):
    yield _heading("What it was not")
    if not report.not_it:
        yield _text(
            "Every effect that was tried was claimed, or fits as well as one that was."
            if report.rounds
            else "No effect was tried: the declared model leaves nothing."
        )
        return
    rows = []
    for row in report.not_it:
        if math.isfinite(row["change"]):
            best = (
                f"error {number(row['error_after'])} instead of {number(row['error_before'])} "
                f"({change(row['error_before'], row['error_after'])}) in round {row['round']}"
            )
            if row["claimed_instead"]:
                best += f"; {row['claimed_instead']} reached {number(row['claimed_error'])}"
            rows.append(("", [row["effect"], best, number(row["p_value"], 2)]))
        else:
            best = f"explains {share(row['screen'])} of the residual's power, not contested"
            rows.append(("faint", [row["effect"], best, "–"]))
    yield _table(["effect", "at best", "p"], "llr", rows)


def _next(report):
    if report.next_steps:
        yield _heading("What to measure next")
        yield {"kind": "items", "items": report.next_steps}


def _parameters(report):
    yield _heading("Parameters")
    for title, name in (("With what was found", "augmented"), ("Declared model", "declared")):
        if name == "augmented" and not report.effects:
            continue
        yield _heading(title, 3)
        yield {"kind": "code", "text": getattr(report, f"{name}_model")}
        values = report.parameters[name]
        rows = [
            ("", [row["name"], plus_minus(row["value"], row["std"]), row["note"]])
            for row in values
            if row["value"] or row["note"] != "at a bound"
        ]
        left = len(values) - len(rows)
        yield _table(
            ["parameter", "value ± standard error", ""],
            "lrl",
            rows,
            folded=f"{len(rows)} values" if len(rows) > _MANY else "",
        )
        if left:
            yield _text(f"{left} more are zero, at a bound.", "quiet")


def _data(report):
    data = report.data
    yield _heading("Data")
    yield _text(
        f"{data['n_samples']} samples in {data['n_records']} "
        f"record{'s' if data['n_records'] != 1 else ''}, one every {number(data['interval'])} s; "
        f"{data['n_scored']} were scored while held out. Drive: {report.drive_name}. Response: "
        f"{report.response_name}."
    )
    columns = ("duration", "drive_min", "drive_max", "response_min", "response_max")
    rows = [
        ("", [row["label"], str(row["n_samples"]), *(number(row[name]) for name in columns)])
        for row in data["records"][:20]
    ]
    head = ["record", "samples", "seconds", "drive from", "to", "response from", "to"]
    yield _table(head, "lrrrrrr", rows)
    if len(data["records"]) > len(rows):
        yield _text(f"and {len(data['records']) - len(rows)} more records", "quiet")
    if not data["faults"]:
        yield _text(
            "No outliers, lost or stuck readings, clipping at the converter's range or clock "
            "jitter were found.",
            "quiet",
        )
        return
    yield _text("The recording has faults that are no physics. They are in what was fitted:")
    rows = [
        (
            "",
            [
                row["fault"],
                row["record"],
                str(row["n_samples"]),
                ", ".join(map(str, row["rows"])),
                row["advice"],
            ],
        )
        for row in data["faults"][:20]
    ]
    yield _table(["fault", "record", "samples", "first rows", ""], "llrll", rows)


def _origin(report):
    yield _heading("How it was made")
    if report.command:
        yield {"kind": "code", "text": report.command}
    seconds = {name: f"{number(value)} s" for name, value in report.seconds.items()}
    rows = {**report.settings, **report.versions, **seconds}
    yield _table(["", ""], "ll", [("", [name, str(value)]) for name, value in rows.items()])
