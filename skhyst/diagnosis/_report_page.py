"""The text of a report: blocks that a template writes as HTML or as Markdown."""

import math

from ._constants import NOTICEABLE
from ._report_data import failures, is_full, looks
from ._report_text import chance, change, listed, number, percent, plus_minus, share

_NO_CLAIM = {
    "noise": "Nothing is missing: no effect that was tried makes the held-out error significantly "
    "smaller, and it is already at the noise floor.",
    "undetermined": "No effect is claimed, but the recording cannot tell that none is missing: its "
    "records or blocks do not predict each other, or it is too short to tell slow noise from what "
    "follows the drive.",
    "unexplained": "No effect is claimed, though something is left: the error is above the noise "
    "floor, and none of the effects that were tried makes it significantly smaller.",
}
_LEFT = {
    "noise": "what is left is noise",
    "undetermined": "the recording cannot tell",
    "unexplained": "something is left that no effect explains",
}
_PROVISIONAL = (
    "Provisional: in the end more than half of the structure before this claim is left. Another "
    "effect, or one that was not tried, may take its place."
)


def verdict(report):
    """Return the headline and the sentences that say what a search found, warnings first."""
    headline, sentence = _found(report)
    return headline, " ".join([*_warnings(report), sentence])


def _warnings(report):
    worst, part = max(report.error_before, report.error_after), report.data["extrapolated"]
    if worst > report.response_range:
        yield (
            f"A held-out error of {_error(report, worst)} is more than all of the response: the "
            "model runs away on what it was not fitted to."
        )
    if part > NOTICEABLE:
        yield (
            f"The folds extrapolate: {share(part)} of the samples are held out where the drive "
            "goes beyond that of all records or blocks that they are predicted from. With several "
            "records, an int as cv holds out a part of each instead."
        )
    faults = {fault["fault"] for fault in report.data["faults"]}
    if "noisy_drive" in faults:
        yield (
            "The recorded drive has noise that the device has not seen: parameters are biased. "
            "Claims and verdict rest on the smooth part of the drive."
        )
    if "closed_loop" in faults:
        yield (
            "The drive reacts to the noise of the response, as in a closed loop: claims and "
            "parameters may be biased. Record what the controller follows as a further column, and "
            "search with it as the reference."
        )


def _found(report):
    """Return the headline and the sentence of what was found."""
    before, after, floor = (
        _error(report, value)
        for value in (report.error_before, report.error_after, report.noise_floor)
    )
    model = f"The declared model {report.declared_model}"
    explained = report.verdict != "unexplained"
    noise = f"What is left is noise; its floor is {floor}."
    headline, mark = "Nothing is missing", "" if explained else "; and something unexplained"
    if report.verdict == "undetermined":
        headline, mark = "Undetermined", "; and undetermined"
        noise = (
            f"What the fit leaves may be noise, of {floor} or more, but the recording cannot tell: "
            "parts of it go further than the others, or it is too short for so many parameters, or "
            "to tell slow noise from what follows the drive."
        )
    if not report.effects and explained:
        return headline, (
            f"{model} lacks none of the effects that were tried: its held-out error is {before}. "
            f"{noise}"
        )
    if not report.effects:
        return "Unexplained", (
            f"{model} leaves structure that none of the effects that were tried explains: its "
            f"held-out error is {before}, above the noise floor of {floor}. No effect is claimed."
        )
    found = listed(
        claim["effect"] + (f" ({_ambiguity(claim)})" if claim["ambiguous_with"] else "")
        for claim in report.claims
    )
    if any(claim["provisional"] for claim in report.claims):
        found += ", provisionally"
    them = "it" if len(report.effects) == 1 else "them"
    rest = f"What is left is above the noise floor of {floor}, and no effect tried explains it."
    return (
        f"Missing: {', '.join(report.effects)}{mark}",
        f"{model} lacks {found}: with {them} the held-out error falls from {before} to {after}. "
        f"{noise if explained else rest}",
    )


def page(report, figures=None):
    """Return the blocks of a report, from top to bottom: dicts with a ``kind``.

    What only a sceptic reads comes last, in one block that is folded and not printed.
    """

    def blocks(*sections):
        return [block for section in sections for block in section(report, figures)]

    everything = blocks(_candidates, _folds, _residuals, _parameters, _data, _origin)
    title = "For the sceptic: every candidate, every fold, parameters, data, how it was made"
    folded = {"kind": "folded", "text": title, "blocks": everything}
    return [*blocks(_glance, _errors, _signals, _claims, _left, _next), folded]


def _glance(report, figures):
    """Yield what is missing, the errors, how sure that is and what comes next, in four lines."""
    unit, floor = report.units["response"], number(report.noise_floor)
    before, after = number(report.error_before), number(report.error_after)
    sure = [_sure(claim) for claim in report.claims] or [_LEFT[report.verdict]]
    parts = {
        "Missing": ", ".join(report.effects) or report.headline,
        "Error": f"{before} → {after} {unit}".rstrip() + f"; noise floor {floor}",
        "How sure": "; ".join(sure),
        "Next": (report.next_steps or ["nothing more to record"])[0],
    }
    yield {
        **_table(["", "at a glance"], "ll", [list(row) for row in parts.items()]),
        "kind": "glance",
    }


def _sure(claim):
    text = f"{claim['effect']}: {chance(claim['p_value'])}"
    if claim["ambiguous_with"]:
        text += f", not told from {listed(claim['ambiguous_with'])}"
    return text + (", provisional" if claim["provisional"] else "")


def _heading(text, level=2):
    return {"kind": "heading", "text": text, "level": level}


def _text(text, style=""):
    return {"kind": "text", "text": text, "style": style}


def _figure(svg, caption=""):
    return {"kind": "figure", "svg": svg, "text": caption}


def _table(head, align, rows, strong=()):
    """Return a table; ``align`` has a letter a column, ``strong`` are numbers of rows."""
    folded = f"{len(rows)} values" if len(rows) > 24 else ""
    parts = {"head": head, "align": align, "rows": rows, "strong": strong, "folded": folded}
    return {"kind": "table", **parts}


def _error(report, value, whole=None):
    """Write an error in its unit, with its percentage of the range."""
    part = percent(value, report.response_range if whole is None else whole)
    unit = report.units["response"]
    return f"{f'{number(value)} {unit}'.strip()} ({part} of the range)"


def _ambiguity(claim):
    return f"these data cannot tell it from {listed(claim['ambiguous_with'])}"


def _errors(report, figures):
    yield _text(report.sentence, "lead")
    errors = {"declared model": report.error_before}
    if report.effects:
        errors["with what was found"] = report.error_after
    errors["noise floor"] = report.noise_floor
    unit, whole, top = report.units["response"], report.response_range, max(errors.values())
    head = ["error (RMS, held out)", unit or "value", "of the range"]
    rows = [[name, number(own), percent(own, whole)] for name, own in errors.items()]
    widths = [100.0 * own / top if top > 0.0 else 0.0 for own in errors.values()]
    yield {**_table(head, "lrr", rows), "kind": "bars", "widths": widths}
    yield _text(f"The noise in what is left: {report.noise_model['text']}.")
    if report.held_out:
        kept = report.held_out
        whole, names = kept["response_range"], ("before", "after")[: 1 + bool(report.effects)]
        own = [f"{_error(report, kept[f'error_{name}'], whole)} {name}" for name in names]
        count = kept["n_samples"]
        yield _text(f"On {count} samples kept from the search altogether: {', '.join(own)}.")


def _signals(report, figures):
    if figures:
        yield _heading("Measured and predicted")
        yield _figure(
            figures["course"],
            "Measured response over time, and as predicted for samples not seen in fitting.",
        )
        yield _figure(
            figures["loops"],
            "Measured response against drive, and as predicted for samples not seen in fitting. "
            "Below, less the straight line through the measured points.",
        )
    if report.declared_location:
        place = looks(report.declared_location)
        yield _text(f"What the declared model leaves is strongest {place}.")


def _residuals(report, figures):
    if figures:
        yield _heading("Residuals")
        yield _figure(
            figures["residuals"],
            "Measured minus predicted. Lines in the branch pictures are means, bands one standard "
            "deviation; the dotted line is white noise of the size of the noise floor.",
        )


def _candidates(report, figures):
    yield _heading("Every candidate")
    if not report.rounds:
        yield _text("No effect was tried: the declared model leaves nothing.")
        return
    rows, strong = [], []
    for place, round in enumerate(report.rounds):
        own = [row for row in report.ranking if row["round"] == round]
        claimed = [row["effect"] for row in own if row["claimed"]]
        strong += [len(rows) + i for i, row in enumerate(own) if row["claimed"]]
        rows += [[round, *_candidate(row)] for row in own]
        said = f"Round {round}: {', '.join(claimed) or 'nothing'} claimed."
        if not any(math.isfinite(row["error_after"]) for row in own):
            said += " No candidate explains enough to be contested."
        if len(claimed) > 1:
            said += " Neither of the two qualifies alone; together they do."
        yield _text(said)
        if figures and figures["rankings"][place]:
            yield _figure(figures["rankings"][place])
    head = ["round", "effect", "explains", "error", "change", "p", "parameters", ""]
    yield _table(head, "llrrrrrl", rows, strong)
    yield _text(
        "“Explains” is the share of the residual's power that the effect removes when it is "
        "put into the model and fitted briefly; only the best are contested on held-out data. "
        "p is corrected for the number of candidates; an effect is claimed below "
        f"{report.settings['alpha']}.",
        "quiet",
    )


def _folds(report, figures):
    if report.folds:
        yield _heading("Every fold")
        rows = [
            [row["record"], row["fold"], row["n_samples"]]
            + [number(row[f"error_{name}"]) for name in ("before", "after")]
            for row in report.folds
        ]
        yield _table(["record", "fold", "samples scored", "error before", "after"], "lrrrr", rows)


def _candidate(row):
    before, after = row["error_before"], row["error_after"]
    contested = math.isfinite(after)
    return [
        row["effect"],
        share(row["screen"]),
        number(after),
        change(before, after),
        number(row["p_value"], 2),
        row["n_parameters"],
        "claimed" if row["claimed"] else "" if contested else "not contested",
    ]


def _claims(report, figures):
    yield _heading("What is missing, and why we say so")
    for place, claim in enumerate(report.claims):
        yield _heading(f"{place + 1}. {claim['effect']}", 3)
        yield _text(claim["statement"])
        fall = [_error(report, claim[f"error_{name}"]) for name in ("before", "after")]
        told = f"{' to '.join(fall)}, {chance(claim['p_value'])}"
        yield _text(f"The held-out error goes from {told}.")
        if claim["provisional"]:
            yield _text(_PROVISIONAL, "note")
        rows = [[r["name"], plus_minus(r["value"], r["std"]), r["unit"]] for r in claim["numbers"]]
        yield _table(["number", "value ± standard error", "unit"], "lrl", rows)
        if figures:
            yield _figure(figures["evidence"][place])
        told = claim["experiment"]
        if claim["ambiguous_with"]:
            told = f"{_ambiguity(claim).capitalize()}. The simplest is named. To tell: {told}"
        if told:
            yield _text(told, "note")
    if not report.claims:
        yield _text(_NO_CLAIM[report.verdict])


def _left(report, figures):
    if report.dropped:
        was, it = ("was", "it") if len(report.dropped) == 1 else ("were", "them")
        names = listed(report.dropped)
        yield _text(f"{names} had been claimed first, and {was} dropped: later ones replace {it}.")
    for error, names in failures(report.failed).items():
        yield _text(f"Not everything was tried: {listed(names)} failed with {error}", "note")
    if report.verdict == "noise":
        return
    if report.claims and report.verdict == "unexplained":
        why = "no further effect explains it."
        if is_full(report.claims, report.settings):
            why = "no more effects than max_effects allows were tried."
        yield _text(f"Something unexplained remains: {why}", "note")
    if report.location:
        yield _text("What is left is strongest here:")
        rows = [
            [row["by"], row["record"] or "all", number(row["low"]), number(row["high"])]
            + [row["unit"], share(row["share"]), number(row["concentration"], 2)]
            for row in report.location
        ]
        head = ["by", "record", "from", "to", "unit", "share of its power", "times the mean"]
        yield _table(head, "llrrlrr", rows)


def _next(report, figures):
    if report.next_steps:
        yield _heading("What to measure next")
        yield {"kind": "list", "texts": report.next_steps}


def _parameters(report, figures):
    yield _heading("Parameters")
    for title, name in (("With what was found", "augmented"), ("Declared model", "declared")):
        if name == "augmented" and not report.effects:
            continue
        yield _heading(title, 3)
        yield {"kind": "code", "text": getattr(report, f"{name}_model")}
        values = report.parameters[name]
        shown = [row for row in values if row["value"] or row["note"] != "at a bound"]
        rows = [
            [row["name"], plus_minus(row["value"], row["std"]), row["unit"], row["note"]]
            for row in shown
        ]
        yield _table(["parameter", "value ± standard error", "unit", ""], "lrll", rows)
        if len(shown) < len(values):
            yield _text(f"{len(values) - len(shown)} more are zero, at a bound.", "quiet")


def _data(report, figures):
    data = report.data
    yield _heading("Data")
    every = listed(f"{number(dt)} s" for dt in sorted({r["interval"] for r in data["records"]}))
    if report.units["time"] == "sample":
        every = "sample of a time that is not known, so that frequencies are in cycles/sample"
    yield _text(
        f"{data['n_samples']} samples in {data['n_records']} records, one every {every}; "
        f"{data['n_scored']} were scored while held out. "
        f"Drive: {report.drive_name}. Response: {report.response_name}."
    )
    if data["resampling_error"]:
        yield _text(
            "The readings were not evenly spaced: these samples are interpolated between them, "
            f"which changes the response by about {_error(report, data['resampling_error'])}. What "
            "is smaller than that may be owed to it."
        )
    if data["reference"]:
        yield _text(
            f"Reference of the loop: {data['reference']['name']}. It predicts "
            f"{share(data['reference']['share'])} of the drive, and the decisions rest on that. "
            "The fits do not: noise in the rest of the drive biases their parameters."
        )
    ends = ("duration", "drive_min", "drive_max", "response_min", "response_max")
    rows = [
        [row["label"], row["n_samples"], *(number(row[name]) for name in ends)]
        for row in data["records"]
    ]
    lasts = "seconds" if report.units["time"] == "s" else "duration"
    head = ["record", "samples", lasts, "drive from", "to", "response from", "to"]
    yield _table(head, "lrrrrrr", rows)
    faults = [
        [row[name] for name in ("fault", "record", "n_samples")]
        + [", ".join(map(str, row["rows"])), number(row["value"]), row["advice"]]
        for row in data["faults"]
    ]
    if faults:
        yield _text("The recording has faults that are no physics. They are in what was fitted:")
        yield _table(["fault", "record", "samples", "first rows", "value", ""], "llrlrl", faults)
    else:
        yield _text("No faults of the measurement were found.", "quiet")


def _origin(report, figures):
    yield _heading("How it was made")
    if report.command:
        yield {"kind": "code", "text": report.command}
    seconds = {name: f"{number(value)} s" for name, value in report.seconds.items()}
    rows = {**report.settings, **report.versions, **seconds}
    yield _table(["", ""], "ll", [list(row) for row in rows.items()])
