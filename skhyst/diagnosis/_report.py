"""The result of a search: one dict of plain data, and its views.

Only `_collect` reads the search. JSON, the text for a terminal and the template ``report.j2``,
which writes HTML and Markdown, read the dict; the pictures are drawn by the Displays of
:mod:`skhyst.inspection`. New results of a search get an entry in `_collect`, and a sentence that
every view shows a line in `_remarks`.
"""

import base64
import copy
import hashlib
import html
import json
import math
import platform
import re
from dataclasses import asdict
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from typing import Self

import numpy as np

from .._files import printable, replacing
from ..inspection import (
    FAR,
    EffectRankingDisplay,
    EvidenceDisplay,
    HysteresisLoopDisplay,
    PredictionDisplay,
    ResidualDisplay,
    spectrum,
    svg_text,
)
from ..metrics import closed_loops, figures_of
from ..records import by_interval, record_names
from ._constants import NOTICEABLE
from ._effects import EFFECTS
from ._location import locate, strongest
from ._next_experiment import next_experiment
from ._pictures import Picture
from ._reference import column_of
from ._report_text import (
    chance,
    change,
    listed,
    number,
    percent,
    plus_minus,
    probability,
    share,
)

_NO_SETTINGS = ("estimator", "effects", "n_jobs", "verbose")
_WIDTH = 4.8  # inches, width of a picture: letters of 9 points are as many pixels on a telephone
_WIDE = 6.2  # inches, width of a picture with a line of text for each row, which is scrolled
_N_CHANGED = 3  # parameters whose change is reported, those that change most
_N_LOOPS = 24  # loops of the recording in the report, those with the most cycles
_PICTURES = {  # height in inches, caption, and shape of axes
    "course": (4.6, "Response over time, measured and modelled", (2, 1)),
    "loops": (6.4, "Loops, measured and modelled", None),
    "residuals": (5.6, "Residuals in time, by branch, and spectrum", (2, 2)),
}
_RESIDUAL = {
    "noise": "noise",
    "undetermined": "noise or structure, which this recording does not determine",
    "unexplained": "structure that no effect explains",
}
_EXPLAINED = {  # words for the entries of `explained`
    "unknown term": "the term without a name",
    "black box": "only a black box",
    "nothing": "nothing",
}
_VERDICT = {  # of a search that has claimed effects
    "noise": "The residual is noise.",
    "undetermined": "This recording does not show whether more is missing.",
    "unexplained": "The residual still has structure that no effect on the list explains.",
}
_NO_EFFECT = {  # of a search that has claimed none
    "noise": "No missing effect was found: the residual is noise.",
    "undetermined": "This recording does not show whether an effect is missing.",
    "unexplained": "Something is missing, but none of the effects that were tried explains it.",
}
_PROVISIONAL = (
    "Provisional: the residual has structure that no effect explains, so this name may stand for "
    "an effect that is not on the list."
)


class Report:
    """Result of a search for missing effects: a dict of numbers, tables and words, and pictures.

    Make one with :meth:`from_search`. All errors are RMS on held-out samples, in the unit of the
    response. Only ``seconds`` differs between two runs of the same search.

    Parameters
    ----------
    content : dict
        Plain Python data, in which NaN and infinity are None; its entries are attributes too.
    displays : dict of str to Display, default=None
        The pictures of :meth:`to_html`: ``course``, ``loops``, ``residuals``, one for each round
        with contested effects and one for each claim; none by default.

    Attributes
    ----------
    declared_model, augmented_model : str
        The declared model, and the model with the effects that were found.
    effects : list of str
        Effects claimed, in the order in which they were added.
    verdict : {"noise", "unexplained", "undetermined"}
        Of the residual.
    error_before, error_after, noise_floor, response_range : float
        Held-out errors of both models, the error below which no model can be, and the range.
    noise_model : dict
        The fields of the search's :class:`~skhyst.noise.NoiseModel`, and ``text``, its description.
    drive_name, response_name : str
        Names of the columns.
    units : dict of str to str
        Units of ``drive`` and ``response``, "" where unknown, and of ``time``: "s", or "sample"
        where there is no time, with frequencies in cycles/sample.
    claims, ranking, not_it : list of dict
        For each effect claimed its law, errors, p-value, ambiguity, experiment and evidence; every
        candidate of every round; for each effect not claimed the round in which it helped most.
    folds : list of dict
        For each record and fold the number of scored samples and their errors ``before`` and
        ``after``.
    parameters : dict of str to list of dict
        ``"declared"`` and ``"augmented"``: name, value, standard error, unit ("" where there is
        none or it is not known), and a note where there is no error: at a bound, or not determined
        by the data.
    data, settings : dict
        The recording, its faults, the fraction of samples at which folds extrapolate, and the
        reference of its loop; parameters of the search.
    held_out : dict or None
        Errors on data that the search has not used at all.
    comparison : dict or None
        Other models, if they were compared: ``models``, list of dict, the ``best`` and the one
        ``taken``, with the ``reason``.
    versions, seconds : dict
        Packages; time by stage in s.
    command : str or None
        The command that made the report.
    spectra : dict of str to list of float
        ``frequency`` (Hz) and the amplitude spectral density of the residual, ``before`` and
        ``after``, of the records of each sampling ``interval`` (s), one after the other.
    location, declared_location : list of dict
        Where the residual, and that of the declared model, is largest: the record, time, drive,
        rate and frequency at which its mean power is noticeably above the mean of the whole,
        beyond chance.
    failed : list of dict
        Candidates that raised an error: round, effect, error.
    verdict_reason : str
        What decided the verdict.
    noise_ceiling : float
        The held-out error, or the part of it that a black box does not predict.
    resolution, warnings : list of str
        Changes of the declared model's resolution, and warnings of its fits.
    suspects : list of dict
        Effects that would lower the error but are not significant.
    unknown : dict or None
        With ``unknown``, the missing term without a name, as :meth:`Unknown.to_dict` returns it;
        None where there is none.
    explained : dict of str to float
        What explains the response, as fractions of its power, see ``explained_`` of the search.
    parameters_without : list of dict
        Parameters that change by more than their errors explain when the samples with the largest
        residual are left out of the fit, see ``parameters_without_``.
    dropped, next_steps : list of str
        Effects that were added and removed again, and what to measure next.

    Examples
    --------
    A fitted search makes its report::

        report = search.report()
        report.to_html("report.html")
        report.to_dict()["effects"]
    """

    def __init__(self, content, displays=None):
        self.content = content
        self.displays = displays

    @classmethod
    def from_search(cls, search, command=None, *, held_out=None, comparison=None) -> Self:
        """Collect the results of a fitted search.

        Parameters
        ----------
        search : EffectSearchCV
            Fitted.
        command : str or None, default=None
            The command that ran it.
        held_out : tuple (X, y) or None, default=None
            Data that the search has not seen, to report the error on.
        comparison : ModelComparisonDisplay or None, default=None
            Other models, as :func:`skhyst.inspection.compare_models` compares them. One whose error
            is three times smaller than that of the declared model is reported first, unless the
            augmented model is as good.

        Returns
        -------
        Report
        """
        experiment = _experiment(search)
        content = _collect(search, command, held_out, comparison, experiment)
        return cls(content, _displays(search, comparison, experiment))

    def __getattr__(self, name):
        try:  # not self.content, which a copy or a pickle does not have yet while it is restored
            return self.__dict__["content"][name]
        except KeyError:
            raise AttributeError(f"A {type(self).__name__} has no {name!r}.") from None

    def __dir__(self):
        return [*super().__dir__(), *self.content]

    @property
    def headline(self) -> str:
        """The verdict in a few words."""
        return _result(self)[0]

    @property
    def sentence(self) -> str:
        """The verdict after any warnings: what is missing, the errors, the noise floor."""
        return " ".join([*_warnings(self), _result(self)[1]])

    @property
    def summary(self) -> str:
        """The result in plain words: what is missing, how sure, and what to do next."""
        return " ".join(_summary(self))

    @property
    def remarks(self) -> list[str]:
        """Further remarks about the search and the recording, one or two sentences each."""
        return list(_remarks(self))

    def __repr__(self):
        return f"Report: {self.headline}. {self.sentence}"

    def _repr_html_(self):
        """Show the result in a notebook; :meth:`to_html` is complete."""
        claims = "".join(
            f"<li><b>{html.escape(claim['effect'])}</b>: {html.escape(claim['statement'])}</li>"
            for claim in self.claims
        )
        head = f"<b>{html.escape(self.headline)}</b><p>{html.escape(self.sentence)}</p>"
        return f"<div>{head}{f'<ul>{claims}</ul>' if claims else ''}</div>"

    def to_dict(self) -> dict:
        """Return everything but the pictures, in the form of ``report.schema.json``."""
        words = {
            name: getattr(self, name) for name in ("headline", "summary", "sentence", "remarks")
        }
        return copy.deepcopy({"schema": "skhyst.report/1"} | words | self.content)

    def to_json(self, path=None) -> str:
        """Return :meth:`to_dict` as JSON.

        Parameters
        ----------
        path : str, Path or None, default=None
            File to write as well.

        Returns
        -------
        str
            JSON.
        """
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        return _save(printable(text), path)

    def to_text(self) -> str:
        """Return what is missing, the errors, the residual and remarks, in a few lines."""
        lines = [*_better_model(self), self.summary]
        lines += [f"resolution: {', '.join(self.resolution)}"] if self.resolution else []
        none = "nothing" if self.verdict == "noise" else "none of the effects that were tried"
        lines.append(f"missing: {', '.join(self.effects) or none}")
        for claim in self.claims:
            lines.append(f"  {claim['effect']}: {claim['statement']}")
            if claim["ambiguous_with"]:
                lines.append(f"    {_ambiguity(claim)} {claim['experiment']}")
            if claim["provisional"]:
                lines.append(f"    {_PROVISIONAL}")
        if self.unknown:
            error = _error(self, (self.unknown["second"] or self.unknown)["error_after"])
            them = "both" if self.unknown["second"] else "it"
            lines.append(f"unexplained: {self.unknown['text']}; with {them} the error is {error}")
            lines += [f"  {self.unknown['code']}"] if self.unknown["code"] else []
        errors = [_error(self, value) for value in (self.error_before, self.error_after)]
        shares = _explained_shares(self).items()
        parts = ", ".join(f"{_by(self, name)} {share(value)}" for name, value in shares)
        lines += [
            f"held-out error: {' -> '.join(errors)}; noise floor {_error(self, self.noise_floor)}",
            *([f"explained of the declared model's error, in power: by {parts}"] if parts else []),
            f"residual: {_RESIDUAL[self.verdict]}",
            f"noise of the residual: {self.noise_model['text']}",
            *([_unused_data(self)] if self.held_out else []),
            *self.remarks,
            *(f"next: {step}" for step in self.next_steps),
        ]
        return printable("\n".join(lines) + "\n")

    def to_html(self, path=None) -> str:
        """Return a self-contained page, without other files or network access.

        Its only script, which the page allows by its hash, shows values at the pointer and zooms:
        drag a rectangle to zoom in, double-click to go back.

        Parameters
        ----------
        path : str, Path or None, default=None
            File to write as well. An existing file is replaced after the new one is complete.

        Returns
        -------
        str

        Raises
        ------
        ImportError
            Where matplotlib or Jinja2 is not installed.
        OSError
            If the file cannot be written, or is a link; an existing file is then unchanged.
        """
        return _save(_rendered(self, "html"), path)

    def to_markdown(self, path=None) -> str:
        """Return the text and the tables without pictures.

        Parameters
        ----------
        path : str, Path or None, default=None
            File to write as well.

        Returns
        -------
        str
            Markdown.

        Raises
        ------
        ImportError
            Where Jinja2 is not installed.
        OSError
            If the file cannot be written, or is a link; an existing file is then unchanged.
        """
        text = _rendered(self, "markdown")
        # sections without content leave blank lines
        return _save(re.sub(r"\n{3,}", "\n\n", text).strip() + "\n", path)


# --------------------------------------------------------------------------------------- the dict


def _experiment(search):
    """Return the next experiment for ambiguous names, in the recorded range of the drive, or None.

    Other open questions would require further fits, as long as a search.
    """
    if not search._undistinguished and not search.history_["ambiguous_with"].map(len).any():
        return None
    estimator = search.declared_estimator_
    if not hasattr(estimator, "drive_rate_"):  # a black box, whose range of the drive is not known
        return None
    rate = estimator.drive_rate_ if np.isfinite(estimator.drive_rate_) else None
    return next_experiment(search, estimator.drive_range_, rate)


def _collect(search, command, held_out, comparison, experiment):
    """Return the entries of a report by name, as plain data."""
    columns = getattr(search, "feature_names_in_", ["drive"])
    # candidates that were not contested have no error: they follow, best screened first
    order = {"by": ["round", "error_after", "screen"], "ascending": [True, True, False]}
    ranking = search.ranking_.sort_values(**order, kind="stable")
    claims = [_claim(row) for row in search.history_.to_dict("records")]
    not_it, data = _not_it(ranking, claims), _data(search)
    location = _location(search.residual_location_, search.records_)
    declared = locate(search.records_, search.drive_, search.residual_before_, search.units_)
    settings = {
        name: value if value is None or np.isscalar(value) else repr(value)
        for name, value in search.get_params(deep=False).items()
        if name not in _NO_SETTINGS
    }
    models = {"declared": search.declared_estimator_, "augmented": search.best_estimator_}
    entries = {
        **{f"{name}_model": " ".join(repr(model).split()) for name, model in models.items()},
        "effects": search.effects_,
        "verdict": search.verdict_,
        "error_before": float(search.error_before_),
        "error_after": float(search.error_after_),
        "noise_floor": float(search.noise_floor_),
        "response_range": float(np.ptp(search.response_)),
        "noise_model": asdict(search.noise_model_) | {"text": str(search.noise_model_)},
        "drive_name": str(columns[0]),
        "response_name": str(search.response_name_),
        "units": asdict(search.units_),
        "claims": claims,
        "ranking": ranking.to_dict("records"),
        "not_it": not_it,
        "folds": _folds(search),
        "parameters": {name: _parameters(m, search.units_) for name, m in models.items()},
        "data": data,
        "settings": settings,
        "held_out": None if held_out is None else _held_out(search, *held_out),
        "comparison": None if comparison is None else _comparison(comparison),
        "versions": _versions(),
        "seconds": search.seconds_,
        "command": command,
        "spectra": _spectra(search),
        "location": location,
        "declared_location": _location(declared, search.records_),
        "dropped": search.dropped_,
        "failed": search.failed_.to_dict("records"),
        "next_steps": next_steps(
            claims,
            search.suspects_.to_dict("records"),
            location,
            search.verdict_,
            data["faults"],
            settings,
            search.verdict_advice_,
            experiment,
        ),
        "verdict_reason": search.verdict_reason_,
        "noise_ceiling": float(search.noise_ceiling_),
        "resolution": search.resolution_,
        "suspects": search.suspects_.to_dict("records"),
        "unknown": None if search.unknown_ is None else search.unknown_.to_dict(),
        "explained": search.explained_,
        "parameters_without": _changed_parameters(search),
        "warnings": search.warnings_,
    }
    # NaN and infinity are no JSON: they become None
    return json.loads(json.dumps(entries, default=_plain), parse_constant=lambda _: None)


def _plain(value):
    """Return the JSON form of a NumPy value or a picture."""
    if hasattr(value, "curves"):
        curves = [{"label": c[0], "style": c[3], "x": c[1], "y": c[2]} for c in value.curves]
        return vars(value) | {"curves": curves}
    return value.tolist()


def _claim(row):
    """Return one claim: a row of the history with its evidence as plain data."""
    # None for an effect that has been unregistered since the search
    row, effect = dict(row), EFFECTS.get(row["effect"])
    evidence = row.pop("evidence")
    return row | {
        "law": effect.law if effect else "",
        "statement": evidence.statement,
        "numbers": [
            {"name": name, "value": value, "std": std, "unit": unit}
            for name, (value, std, unit) in evidence.numbers.items()
        ],
        "picture": evidence.picture,
    }


def _not_it(ranking, claims):
    """Return, for each effect not claimed, the contest in which it helped most, best first.

    An effect that was never contested appears with the largest share of the residual's power that
    it explained in any round. Effects that fit as well as a claimed one are left out.
    """
    excluded = {name for claim in claims for name in (claim["effect"], *claim["ambiguous_with"])}
    names = ["effect", "round", "screen", "p_value", "error_before", "error_after", "change"]
    table = ranking.assign(change=ranking["error_after"] / ranking["error_before"] - 1.0)[names]
    table = table[~table["effect"].isin(excluded)]
    table = table.sort_values(["change", "screen"], ascending=[True, False], kind="stable")
    claimed = ranking[ranking["claimed"].astype(bool)].drop_duplicates("round").set_index("round")
    winners, rows = claimed.to_dict("index"), []
    for row in table.drop_duplicates("effect").to_dict("records"):
        winner = winners.get(row["round"], {})
        row["claimed_instead"] = winner.get("effect")
        row["claimed_error"] = winner.get("error_after", math.nan)
        rows.append(row)
    return rows


def _folds(search):
    """Return the held-out errors of every fold in every record."""
    rows = []
    for record, name in zip(search.records_, record_names(search.records_), strict=True):
        fold_of = search.folds_[record.rows]
        squares = {
            f"error_{name}": getattr(search, f"residual_{name}_")[record.rows] ** 2
            for name in ("before", "after")
        }
        scored = np.isfinite(sum(squares.values()))  # not where a record or block begins
        for fold in np.unique(fold_of[scored & (fold_of >= 0)]):
            at = scored & (fold_of == fold)
            errors = {name: float(np.sqrt(square[at].mean())) for name, square in squares.items()}
            row = {"record": str(name), "fold": int(fold), "n_samples": int(at.sum())}
            rows.append(row | errors)
    return rows


def _parameters(estimator, words):
    """Return the parameters of a model, one row per value, with known standard errors."""
    rows, errors = [], getattr(estimator, "params_std_", {})
    operator = getattr(estimator, "operator_", None)
    entries = [] if operator is None else operator.entries()
    units = {name.removeprefix("model__"): words.of(spec.unit) for name, spec in entries}
    for name, value in getattr(estimator, "params_", {}).items():
        values = np.ravel(value)
        stds = np.broadcast_to(np.ravel(errors.get(name, np.nan)), values.shape)
        for k, (entry, std) in enumerate(zip(values, stds, strict=True)):
            label = name if np.ndim(value) == 0 else f"{name}[{k}]"
            # an infinite standard error, or none
            note = "not determined" if np.isinf(std) else "at a bound" if np.isnan(std) else ""
            row = {"value": float(entry), "std": float(std), "unit": units.get(label, "")}
            rows.append({"name": label, **row, "note": note})
    return rows


def _data(search):
    """Return a description of the recording: records, samples, intervals, ranges."""
    signals, records = {"drive": search.drive_, "response": search.response_}, []
    for record, name in zip(search.records_, record_names(search.records_), strict=True):
        row = {
            "label": str(name),
            "n_samples": record.n_samples,
            "start_time": record.start_time,
            "interval": record.dt,
            "duration": record.duration,
        }
        for name, signal in signals.items():
            part = signal[record.rows]
            row |= {f"{name}_min": float(part.min()), f"{name}_max": float(part.max())}
        records.append(row)
    faults = search.data_quality_.astype({"record": str})
    loops = figures_of(*signals.values(), closed_loops(search.drive_, search.records_))
    loops = loops[loops["n_cycles"] > 0].reset_index().astype({"record": str})
    loops = loops.nlargest(_N_LOOPS, "n_cycles").sort_index()
    return {
        "n_records": len(records),
        "n_samples": len(search.response_),
        "n_scored": int(np.count_nonzero(np.isfinite(search.residual_before_))),
        "n_inputs": search.n_features_in_,
        "resampling_error": search.resampling_error_,
        "interval": min(record.dt for record in search.records_),
        "records": records,
        "extrapolated": float(search.extrapolated_),
        "reference": _reference(search),
        "faults": faults.to_dict("records"),
        "loops": loops.to_dict("records"),
    }


def _reference(search):
    """Return the name of the reference and the fraction of the drive that it predicts, or None."""
    if search.reference is None:
        return None
    column = column_of(search)
    names = getattr(search, "feature_names_in_", None)
    name = f"column {column}" if names is None else str(names[column])
    return {"name": name, "share": float(search.reference_share_)}


def _held_out(search, X, y):
    """Return the errors of both models on data that the search has not used."""
    return {
        "n_samples": len(y),
        "response_range": float(np.ptp(np.asarray(y, dtype=float))),
        "error_before": search.held_out_error(X, y, declared=True),
        "error_after": search.held_out_error(X, y),
    }


def _comparison(comparison):
    """Return the compared models, the best one, and the one to declare."""
    table = comparison.table.reset_index(names="model")
    choice = {"taken": comparison.taken, "best": comparison.best, "reason": comparison.reason}
    return choice | {"models": table.to_dict("records")}


def _location(table, slices):
    """Return the strongest row of each signal by which the residual is located."""
    labels = {name: str(name) for name in record_names(slices)}  # in the table, 1 is 1.0
    rows = strongest(table).to_dict("records")
    return [{**row, "record": labels.get(row["record"])} for row in rows]


def _changed_parameters(search):
    """Return the parameters that change if the samples with the largest residual are left out."""
    labels = {name: str(name) for name in record_names(search.records_)}
    table = search.parameters_without_
    rows = table[table["moved"].astype(bool)].to_dict("records")
    return [{**row, "record": labels.get(row["record"])} for row in rows]


def _spectra(search):
    """Return the spectral density of the residual before and after, for each sampling interval."""
    unscored = np.isnan(search.residual_before_ + search.residual_after_)
    found = {"interval": [], "frequency": [], "before": [], "after": []}
    for dt, numbers in by_interval(search.records_).items():
        spans = [search.records_[i].rows for i in numbers]
        for name in ("before", "after"):
            residual = np.where(unscored, np.nan, getattr(search, f"residual_{name}_"))
            frequency, density = spectrum(residual, spans, dt, per_decade=40)
            found[name] += density.tolist()
        found["frequency"] += frequency.tolist()
        found["interval"] += [dt] * len(frequency)
    return found


def _versions():
    """Return package name -> version, Python first."""
    versions = {"python": platform.python_version()}
    for package in ("skhyst", "numpy", "scipy", "scikit-learn", "pandas", "numba"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return versions


def next_steps(claims, suspects, location, verdict, faults, settings, advice="", experiment=None):
    """Return what to measure next, a list of sentences."""
    steps = []
    if kinds := _to_correct(faults):
        steps.append(
            f"Correct the faults of the recording ({kinds}), listed under Data, and search again."
        )
    steps += [
        f"To distinguish {claim['effect']} from {listed(claim['ambiguous_with'])}: "
        f"{claim['experiment']}"
        for claim in claims
        if claim["ambiguous_with"]
    ]
    for row in [row for row in suspects if row["p_value"] >= settings["alpha"]][:2]:
        effect, fall = EFFECTS.get(row["effect"]), 1.0 - row["error_after"] / row["error_before"]
        steps.append(
            f"{row['effect']} would reduce the error by {number(100.0 * fall, 2)} %, "
            f"which is not significant with these records ({chance(row['p_value'])}). To "
            f"test for it: {effect.experiment if effect else ''}".rstrip()
        )
    if verdict == "unexplained" and _is_full(claims, settings):
        steps.append(
            f"Search again with more effects: the search ended with as many as max_effects = "
            f"{settings['max_effects']} allows."
        )
    elif verdict == "unexplained":
        step = "Record more data where no effect explains the residual"
        place = _location_text(location)
        steps.append(
            f"{step}: it is strongest {place}."
            if place
            else f"{step}, and repeat one record exactly: what repeats is structure, the rest "
            "is noise."
        )
    if advice:
        place = _location_text(location)
        place = f" The residual is largest {place}." if place else ""
        steps.append(f"{advice[0].upper()}{advice[1:]}.{place}")
    if experiment is not None:
        steps.append(
            f"Record next, within the range and the rate of the drive so far: {experiment.reason} "
            "As a file, for these limits or others: skhyst next on the command line, "
            "skhyst.diagnosis.next_experiment in Python."
        )
    elif verdict != "noise" or any(claim["ambiguous_with"] for claim in claims):
        steps.append(
            "Let the search propose the most informative drive within your limits, as a file: "
            "skhyst next on the command line, skhyst.diagnosis.next_experiment in Python."
        )
    return steps


def _to_correct(faults):
    """Return the faults of a measurement that are in the data of the fit, in words, or ""."""
    kinds = dict.fromkeys(fault["fault"].replace("_", " ") for fault in faults)
    kinds.pop("lost rows", None)  # which are left out of the fit
    return listed(kinds) if kinds else ""


# ------------------------------------------------------------------------------------------ words


def _better_model(report):
    """Yield a sentence if another model explains far more than the declared and augmented ones."""
    comparison = report.comparison
    if comparison is None:
        return
    best = next(row for row in comparison["models"] if row["model"] == comparison["best"])
    ratio, margin = report.error_before / best["error"], 1.0 + report.settings["min_improvement"]
    if ratio > FAR and report.error_after > margin * best["error"]:
        yield (
            f"Another model explains far more: {best['model']} ({best['about']}) has a held-out "
            f"error of {_error(report, best['error'])}, {number(ratio, 2)} times smaller than the "
            "declared model. Declare it, or take the names of effects as provisional."
        )


def _warnings(report):
    """Yield what makes the result doubtful, one sentence or two each."""
    yield from _better_model(report)
    error, fraction = max(report.error_before, report.error_after), report.data["extrapolated"]
    if error > report.response_range:
        yield (
            f"A held-out error of {_error(report, error)} is more than the range of the response: "
            "the model diverges on data to which it was not fitted."
        )
    if fraction > NOTICEABLE:
        yield (
            f"The folds extrapolate: {share(fraction)} of the samples are held out where the drive "
            "is beyond its range in the records or blocks that the model is fitted to. With "
            "several records, an int as cv holds out a part of each instead."
        )
    faults = {fault["fault"] for fault in report.data["faults"]}
    if "noisy_drive" in faults:
        yield (
            "The recorded drive has noise that does not act on the device: parameters are "
            "biased. Claims and verdict use only the smooth part of the drive."
        )
    if "closed_loop" in faults:
        yield (
            "The drive reacts to the noise of the response, as in a closed loop: claims and "
            "parameters may be biased. Record what the controller follows as a further column, and "
            "search with it as the reference."
        )


def _summary(report):
    """Yield the result in short sentences."""
    if report.effects:
        explained = max(1.0 - (report.error_after / report.error_before) ** 2, 0.0)
        explain = "it explains" if len(report.effects) == 1 else "together they explain"
        yield (
            f"The model lacks {listed(report.effects)}: {explain} {number(100.0 * explained)} % of "
            "the power of its held-out error."
        )
        provisional = [claim["effect"] for claim in report.claims if claim["provisional"]]
        ambiguous = [claim for claim in report.claims if claim["ambiguous_with"]]
        if provisional:
            yield "It is certain that something is missing, but not which effect."
        elif ambiguous:
            names = listed(
                f"{claim['effect']} may be {' or '.join(claim['ambiguous_with'])} instead"
                for claim in ambiguous
            )
            yield f"It is certain that something is missing, but {names}."
        else:
            yield (
                "Sure: where nothing is missing, at most "
                f"{100.0 * report.settings['alpha']:g} % of searches claim an effect."
            )
    yield _VERDICT[report.verdict] if report.effects else _NO_EFFECT[report.verdict]
    if faults := _to_correct(report.data["faults"]):
        yield f"But the recording has faults, which may be the cause: {faults}."
    count = len(report.next_steps)
    steps = {0: "nothing more to record", 1: "the step below"}.get(
        count, f"the {count} steps below"
    )
    yield f"Next: {steps}."


def _result(report):
    """Return the headline and the sentence of the result."""
    before, after, floor = (
        _error(report, value)
        for value in (report.error_before, report.error_after, report.noise_floor)
    )
    model = f"The declared model {report.declared_model}"
    if report.resolution:
        model += f" (declared {', '.join(report.resolution)})"
    explained = report.verdict != "unexplained"
    noise = f"The residual is noise; its floor is {floor}."
    headline, suffix = "Nothing is missing", "" if explained else "; and unexplained structure"
    if report.verdict == "undetermined":
        headline, suffix = "Undetermined", "; more may be missing"
        noise = (
            f"The residual may be noise, of {floor} or more, but this recording does not determine "
            f"it: {report.verdict_reason}."
        )
    if not report.effects and explained:
        return headline, (
            f"{model} lacks none of the effects that were tried: its held-out error is {before}. "
            f"{noise}"
        )
    if not report.effects:
        return "Unexplained", (
            f"{model} has a residual with structure that none of the effects tried explains: the "
            f"held-out error is {before}, above the noise floor of {floor}. No effect is claimed."
        )
    effects = listed(
        f"{claim['effect']} (which these data do not distinguish from "
        f"{listed(claim['ambiguous_with'])})"
        if claim["ambiguous_with"]
        else claim["effect"]
        for claim in report.claims
    )
    if any(claim["provisional"] for claim in report.claims):
        effects += ", which may stand for an effect that is not on the list"
    them = "it" if len(report.effects) == 1 else "them"
    rest = f"The residual is above the noise floor of {floor}, and no effect tried explains it."
    fall = f"the held-out error falls from {before} to {after}"
    if report.error_after > report.error_before:
        first, last = report.claims[0]["error_before"], report.claims[-1]["error_after"]
        fall = (
            f"the error on held-out blocks falls from {_error(report, first)} to "
            f"{_error(report, last)}, but on whole records it rises from {before} to {after}, "
            "since the records do not predict each other"
        )
    return (
        f"Missing: {', '.join(report.effects)}{suffix}",
        f"{model} lacks {effects}: with {them} {fall}. {noise if explained else rest}",
    )


def _remarks(report):
    """Yield the remarks that every view adds to the verdict."""
    data, dropped = report.data, report.dropped
    yield from report.warnings
    if report.suspects:
        suspects = ", ".join(
            f"{row['effect']} ({_error(report, row['error_before'])} to "
            f"{_error(report, row['error_after'])}, {chance(row['p_value'])})"
            for row in report.suspects[:2]
        )
        yield f"Would lower the error most, but is not significant: {suspects}."
    for place in dict.fromkeys(map(_place, report.parameters_without)):
        rows = [row for row in report.parameters_without if _place(row) == place]
        rows.sort(key=lambda row: -abs(row["value_without"] - row["value"]) / row["std_without"])
        changes = listed(
            f"{row['parameter']} is {plus_minus(row['value_without'], row['std_without'])} instead "
            f"of {plus_minus(row['value'], row['std'])}"
            for row in rows[:_N_CHANGED]
        )
        yield f"Without the samples {place}, where the residual is large, {changes}."
    if dropped:
        was, them = ("was", "it") if len(dropped) == 1 else ("were", "them")
        yield (
            f"{listed(dropped)} {was} added and removed again: without {them} the held-out error "
            "is not significantly larger."
        )
    for error, names in _failures(report.failed).items():
        yield f"Not all effects were tried: {listed(names)} failed with {error}"
    if data["resampling_error"]:
        yield (
            "The readings were not evenly spaced: these samples are interpolated between them, "
            f"which changes the response by about {_error(report, data['resampling_error'])}. "
            "Smaller residuals may be due to it."
        )
    if data["reference"]:
        yield (
            f"Reference of the loop: {data['reference']['name']}. It predicts "
            f"{share(data['reference']['share'])} of the drive; claims and verdict use that part "
            "only. The fits use the whole drive: noise in the rest of it biases their parameters."
        )


def _known_and_unknown(report):
    """Return sentences on what is known of a residual that need not be noise, and what is not."""
    if report.verdict == "noise" or not report.error_after:
        return []
    upper, lower = (
        min(max(1.0 - (error / report.error_after) ** 2, 0.0), 1.0)
        for error in (report.noise_floor, report.noise_ceiling)
    )
    most, least = ("nearly all" if part > 0.999 else share(part) for part in (upper, lower))
    known = f"Known: {'' if upper > 0.999 else 'at most '}{most} of the power of the residual can "
    known += "follow the drive"
    if lower < 0.001:
        known += "; the rest is noise." if upper <= 0.999 else "."
    else:
        known += f", and {'' if lower > 0.999 else 'at least '}{least} does."
    if report.verdict == "undetermined":
        return [known, "Not known: how much of it does, and how much is slow noise."]
    unknown = "Not known: its law; none of the effects tried has it."
    if report.unknown is None and not report.settings["unknown"]:
        unknown += " A search with unknown=True (--unknown) estimates it as a curve."
    return [known, unknown]


def _explained_shares(report):
    """Return the fractions of the declared model's error, in power, by what explains them."""
    _, *parts = report.explained.items()  # the first is the part of the declared model
    total = sum(value for _, value in parts)
    if not total > 0.0 or report.explained["nothing"] >= total:
        return {}
    return {name: value / total for name, value in parts if value > 0.0}


def _by(report, name):
    """Return words for an entry of `explained`; a raised resolution counts with the effects."""
    found = ["what was found"] * bool(report.effects) + ["a finer model"] * bool(report.resolution)
    return _EXPLAINED.get(name) or " and ".join(found or ["the model fitted again"])


def _error(report, value, whole=None):
    """Write an error in its unit, with its percentage of the range."""
    part = percent(value, report.response_range if whole is None else whole)
    unit = report.units["response"]
    return f"{f'{number(value)} {unit}'.strip()} ({part} of the range)"


def _unused_data(report):
    """Return a sentence with the errors on data that the search has not used."""
    new, names = report.held_out, ("before", "after")[: 1 + bool(report.effects)]
    errors = [f"{_error(report, new[f'error_{n}'], new['response_range'])} {n}" for n in names]
    return f"On {new['n_samples']} samples that the search has not used: {', '.join(errors)}."


def _certainty(claim):
    """Return how sure a claim is, in words."""
    text = f"{claim['effect']}: {chance(claim['p_value'])}"
    if claim["ambiguous_with"]:
        text += f", not distinguished from {listed(claim['ambiguous_with'])}"
    return text + (", provisional" if claim["provisional"] else "")


def _ambiguity(claim):
    """Return what else a claim may be, in words."""
    others = listed(claim["ambiguous_with"])
    return (
        f"These data do not distinguish it from {others}; the simplest of them is named. To "
        "distinguish them:"
    )


def _location_text(location):
    """Return where a residual is strongest, in words.

    Examples
    --------
    >>> row = {"by": "frequency", "record": None, "low": 10.0, "high": 20.0, "unit": "Hz"}
    >>> row |= {"concentration": 4.0, "concentration_low": 3.0, "concentration_high": 5.0}
    >>> _location_text([row]), _location_text([])
    ('from 10.0 to 20.0 Hz (4.0 times the mean power, 3.0 to 5.0)', '')
    """
    keys = "concentration", "concentration_low", "concentration_high"
    rows = [(_place(row), *(number(row[key], 2) for key in keys)) for row in location]
    return "; ".join(
        f"{place} ({times} times the mean power, {low} to {high})"
        for place, times, low, high in rows
    )


def _place(row):
    """Return the samples or frequencies of a row of the location, in words."""
    places = {
        "record": "in record {record}",
        "time": "from {low} to {high} {unit} of record {record}",
        "drive": "where the drive is from {low} to {high}{known}",
        "amplitude": "where the amplitude of the drive is from {low} to {high}{known}",
        "rate": "where the drive's rate is from {low} to {high}{known}",
        "direction": "where the drive is {way}",
        "frequency": "from {low} to {high} {unit}",
    }
    return places[row["by"]].format(
        record=row["record"],
        low=number(row["low"]),
        high=number(row["high"]),
        unit=row["unit"],
        known="" if row["unit"].startswith("drive") else f" {row['unit']}",
        way="rising" if row["low"] > 0.0 else "falling",
    )


def _is_full(claims, settings):
    """Whether a search ended because it had claimed `max_effects` effects."""
    return len(claims) == settings["max_effects"]


def _failures(failed):
    """Return the effects that failed, by their error, each once."""
    found = {}
    for row in failed:
        names = found.setdefault(row["error"], [])
        names += [row["effect"]] * (row["effect"] not in names)
    return found


# ----------------------------------------------------------------------------------------- views


def _displays(search, comparison=None, experiment=None):
    """Return the pictures by name, to be drawn later."""
    displays = {
        "course": PredictionDisplay.from_search(search, draw=False),
        "loops": HysteresisLoopDisplay.from_search(search, draw=False),
        "residuals": ResidualDisplay.from_search(search, draw=False),
    }
    contested = search.ranking_[search.ranking_["error_after"].notna()]
    for n in map(int, contested["round"].unique()):
        displays[f"round {n}"] = EffectRankingDisplay.from_search(search, round=n, draw=False)
    if search.unknown_ is not None:
        displays["unknown"] = EvidenceDisplay(search.unknown_.picture())
        if search.unknown_.second is not None:
            displays["unknown second"] = EvidenceDisplay(search.unknown_.second.picture())
    if experiment is not None:
        drive, units = experiment.from_rest(), search.units_
        curve = "", drive.index.to_numpy(), drive.to_numpy(), "line"
        labels = units.label("time (s)"), units.label("drive (drive)").replace(" (drive)", "")
        displays["next"] = EvidenceDisplay(Picture("Drive to record next", *labels, (curve,)))
    if comparison is not None:
        displays["models"] = comparison
    for name in search.effects_:
        displays[f"evidence {name}"] = EvidenceDisplay.from_search(search, name, draw=False)
    return displays


def _drawn(name, display):
    """Return a picture as SVG text for a page."""
    height, label, shape = _PICTURES.get(name, (3.4, name.capitalize(), (1, 1)))
    width = _WIDE if name == "models" or name.startswith("round") else _WIDTH
    if name.startswith("round"):  # one line of text a row, below and above them the axes
        height = 0.95 + 0.24 * len(display.ranking)
    elif name == "models":
        height, label = 0.95 + 0.24 * len(display.table), "Models, held-out errors"
    elif name.startswith("evidence"):
        label = f"Evidence for {name.removeprefix('evidence ')}"
        height = 3.4 if display.picture.below is None else 5.4
    elif name == "next":
        label = "Drive to record next, over time"
    elif name.startswith("unknown"):
        height, label = 5.4, "The unexplained term as a curve with its band"

    def draw(figure):
        if name != "loops":
            display.plot(ax=figure.subplots(*shape))
            return
        panels = 2, len(display.predictions)
        axes = figure.subplots(*panels, squeeze=False, sharex=True, sharey="row")
        for row, subtract in zip(axes, (False, True), strict=True):
            display.plot(ax=row, subtract_line=subtract)
        for ax in axes[0]:
            ax.set_xlabel("")

    return svg_text(draw, (width, height), label)


@cache
def _template(form):
    """Return the template for "html" or "markdown", and the script of the page."""
    try:
        import jinja2
        import markupsafe
    except ImportError as error:
        raise ImportError(
            "A report as HTML or Markdown needs Jinja2, which is not installed. "
            'Install it with: python -m pip install "skhyst[plot]"'
        ) from error
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("skhyst.diagnosis", "_templates"),
        autoescape=form == "html",
        undefined=jinja2.StrictUndefined,  # a misspelt name is an error, not an empty place
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )

    def escaped(text):
        """Return text with the characters escaped that HTML or Markdown would interpret."""
        text = " ".join(str(markupsafe.escape(text) if form == "html" else text).split())
        if form == "html":  # a number and its sign stay on one line
            return markupsafe.Markup(re.sub(r"(?<=\d) (?=%|×)", "\u00a0", text))
        return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", text)

    environment.filters |= {
        "escaped": escaped,
        "location_text": _location_text,
        "place": _place,
        "certainty": _certainty,
        "ambiguity": _ambiguity,
    }
    environment.filters |= {
        f.__name__: f for f in (chance, listed, number, percent, probability, share)
    }
    script = environment.loader.get_source(environment, "pictures.js")[0]
    return environment.get_template("report.j2"), script


def _rendered(report, form):
    """Return the page as "html" or "markdown"."""
    template, script = _template(form)
    figures = {} if form == "markdown" else report.displays or {}
    return printable(
        template.render(
            r=report.to_dict(),
            form=form,
            figures={name: _drawn(name, display) for name, display in figures.items()},
            residual=_RESIDUAL,
            provisional=_PROVISIONAL,
            known_and_unknown=_known_and_unknown(report),
            explained_shares=_explained_shares(report),
            explained_by=partial(_by, report),
            unused_data=_unused_data(report) if report.held_out else "",
            is_full=_is_full(report.claims, report.settings),
            change=change,
            error=partial(_error, report),
            plus_minus=plus_minus,
            script=script,
            # the page allows this script alone: no text of a recording can run as another
            script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        )
    )


def _save(content, path):
    """Write the content if a path is given, and return it."""
    if path is not None:
        with replacing(path) as (part,):
            part.write_text(content, encoding="utf-8")
    return content
