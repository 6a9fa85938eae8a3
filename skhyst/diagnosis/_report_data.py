"""From a fitted search to the plain data of a report."""

import math
import platform
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from ..inspection import spectrum
from ..records import by_interval
from ._effects import EFFECTS
from ._location import locate
from ._reference import column_of
from ._report_text import listed, number

_NO_SETTINGS = ("estimator", "effects", "n_jobs", "verbose")


def collect(search, command, held_out):
    """Return the fields of a :class:`skhyst.diagnosis.Report`, by name."""
    columns = getattr(search, "feature_names_in_", ["drive"])
    names = {"drive_name": str(columns[0]), "response_name": str(search.response_name_)}
    order = {"by": ["round", "error_after", "screen"], "ascending": [True, True, False]}
    ranking = search.ranking_.sort_values(**order, kind="stable")
    claims = [_claim(row) for row in search.history_.to_dict("records")]
    not_it, data = _not_it(ranking, claims), _data(search)
    location = _location(search.residual_location_, search.records_)
    settings = {
        name: value if value is None or np.isscalar(value) else repr(value)
        for name, value in search.get_params(deep=False).items()
        if name not in _NO_SETTINGS
    }
    place = search.records_, search.drive_, search.residual_before_, search.units_
    declared = locate(*place)
    models = {"declared": search.declared_estimator_, "augmented": search.best_estimator_}
    predictions = {"declared model": search.prediction_before_}
    if search.effects_:
        predictions["with " + ", ".join(search.effects_)] = search.prediction_after_
    signals = {
        "drive": search.drive_,
        "response": search.response_,
        "predictions": predictions,
        "records": search.records_,
        "noise_floor": search.noise_floor_,
    }
    return {
        **{f"{name}_model": " ".join(repr(model).split()) for name, model in models.items()},
        "effects": list(search.effects_),
        "verdict": search.verdict_,
        "error_before": float(search.error_before_),
        "error_after": float(search.error_after_),
        "noise_floor": float(search.noise_floor_),
        "response_range": float(np.ptp(search.response_)),
        "noise_model": asdict(search.noise_model_) | {"text": str(search.noise_model_)},
        **names,
        "units": asdict(search.units_),
        "claims": claims,
        "ranking": ranking.to_dict("records"),
        "folds": _folds(search),
        "not_it": not_it,
        "parameters": {name: _parameters(m, search.units_) for name, m in models.items()},
        "data": data,
        "settings": settings,
        "held_out": None if held_out is None else _held_out(search, *held_out),
        "versions": _versions(),
        "seconds": dict(search.seconds_),
        "command": command,
        "spectra": _spectra(search),
        "location": location,
        "declared_location": _location(declared, search.records_),
        "dropped": list(search.dropped_),
        "failed": search.failed_.to_dict("records"),
        "next_steps": next_steps(
            claims,
            not_it,
            location,
            search.verdict_,
            data["faults"],
            settings,
            search.verdict_advice_,
        ),
        "signals": signals | names,
    }


def _folds(search):
    """Return the held-out errors of every fold in every record."""
    rows = []
    for record in search.records_:
        own = search.folds_[record.rows]
        squares = {
            f"error_{name}": getattr(search, f"residual_{name}_")[record.rows] ** 2
            for name in ("before", "after")
        }
        scored = np.isfinite(sum(squares.values()))
        for fold in np.unique(own[scored & (own >= 0)]):
            at = scored & (own == fold)
            errors = {name: float(np.sqrt(square[at].mean())) for name, square in squares.items()}
            which = {"record": str(record.label), "fold": int(fold), "n_samples": int(at.sum())}
            rows.append(which | errors)
    return rows


def _versions():
    """Return package name -> version, Python first."""
    versions = {"python": platform.python_version()}
    for package in ("skhyst", "numpy", "scipy", "scikit-learn", "pandas", "numba"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return versions


def _claim(row):
    """Return one claim: a row of the history with what its evidence says."""
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
    own = ranking.assign(change=ranking["error_after"] / ranking["error_before"] - 1.0)[names]
    own = own[~own["effect"].isin(excluded)]
    own = own.sort_values(["change", "screen"], ascending=[True, False], kind="stable")
    claimed = ranking[ranking["claimed"].astype(bool)].drop_duplicates("round").set_index("round")
    winners, rows = claimed.to_dict("index"), []
    for row in own.drop_duplicates("effect").to_dict("records"):
        winner = winners.get(row["round"], {})
        instead = winner.get("effect"), winner.get("error_after", math.nan)
        rows.append(row | {"claimed_instead": instead[0], "claimed_error": instead[1]})
    return rows


def _parameters(estimator, words):
    """Return the parameters of a model, one row a value, with standard errors where known."""
    rows, errors = [], getattr(estimator, "params_std_", {})
    operator = getattr(estimator, "operator_", None)
    units = {} if operator is None else operator.parameter_units()
    units = {name.removeprefix("model__"): words.of(unit) for name, unit in units.items()}
    for name, value in getattr(estimator, "params_", {}).items():
        values = np.ravel(value)
        stds = np.broadcast_to(np.ravel(errors.get(name, np.nan)), values.shape)
        for k, (item, std) in enumerate(zip(values, stds, strict=True)):
            label = name if np.ndim(value) == 0 else f"{name}[{k}]"
            # no standard error: infinite, or none at all
            note = "not determined" if np.isinf(std) else "at a bound" if np.isnan(std) else ""
            own = {"value": float(item), "std": float(std), "unit": units.get(label, "")}
            rows.append({"name": label, **own, "note": note})
    return rows


def _data(search):
    """Return what the recording is: records, samples, interval, ranges."""
    signals, records = {"drive": search.drive_, "response": search.response_}, []
    for record in search.records_:
        own = {
            "label": str(record.label),
            "n_samples": record.n_samples,
            "start_time": record.start_time,
            "interval": record.dt,
            "duration": record.dt * record.n_samples,
        }
        for name, signal in signals.items():
            part = signal[record.rows]
            own |= {f"{name}_min": float(part.min()), f"{name}_max": float(part.max())}
        records.append(own)
    faults = search.data_quality_.astype({"record": str})
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
    }


def _reference(search):
    """Return the name of the reference and the part of the drive that it predicts, or None."""
    if search.reference is None:
        return None
    at = column_of(search)
    names = getattr(search, "feature_names_in_", None)
    name = f"column {at}" if names is None else str(names[at])
    return {"name": name, "share": float(search.reference_share_)}


def _held_out(search, X, y):
    """Return the errors of both models on data that the search has not seen."""
    return {
        "n_samples": len(y),
        "response_range": float(np.ptp(np.asarray(y, dtype=float))),
        "error_before": search.held_out_error(X, y, declared=True),
        "error_after": search.held_out_error(X, y),
    }


def _location(table, slices):
    """Return the strongest entry of each way to look at what is left."""
    labels = {s.label: str(s.label) for s in slices}  # the table holds 1 as 1.0
    strongest = table[table["concentration"] > 1.5].groupby("by", sort=False).head(1)
    rows = strongest.to_dict("records")
    return [{**row, "record": labels.get(row["record"])} for row in rows]


def _spectra(search):
    """Return the amplitude spectral density of the residual before and after, by the interval."""
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


def looks(location):
    """Say where a residual stands.

    Examples
    --------
    >>> row = {"by": "frequency", "record": None, "low": 10.0, "high": 20.0, "unit": "Hz"}
    >>> looks([row | {"concentration": 4.0}]), looks([])
    ('from 10.0 to 20.0 Hz (4.0 times the mean power)', '')
    """
    places = {
        "record": "in record {record}",
        "time": "from {low} to {high} {unit} of record {record}",
        "drive": "where the drive is from {low} to {high}{known}",
        "rate": "where the drive's rate is from {low} to {high}{known}",
        "frequency": "from {low} to {high} {unit}",
    }
    return "; ".join(
        places[row["by"]].format(
            record=row["record"],
            low=number(row["low"]),
            high=number(row["high"]),
            unit=row["unit"],
            known="" if row["unit"].startswith("drive") else f" {row['unit']}",
        )
        + f" ({number(row['concentration'], 2)} times the mean power)"
        for row in location
    )


def is_full(claims, settings):
    """Whether a search ended because it had claimed as many effects as it may."""
    return len(claims) == settings["max_effects"]


def failures(failed):
    """Return the effects that were left out, once each, by the error."""
    found = {}
    for row in failed:
        names = found.setdefault(row["error"], [])
        names += [row["effect"]] * (row["effect"] not in names)
    return found


def next_steps(claims, not_it, location, verdict, faults, settings, advice=""):
    """Return what to measure next, a list of sentences."""
    steps = [
        f"To tell {claim['effect']} from {listed(claim['ambiguous_with'])}: {claim['experiment']}"
        for claim in claims
        if claim["ambiguous_with"]
    ]
    misses = [
        row
        for row in not_it
        if row["p_value"] >= settings["alpha"]
        and row["change"] < -0.05
        and row["claimed_instead"] is None
    ]
    for row in misses[:2]:
        effect = EFFECTS.get(row["effect"])
        steps.append(
            f"{row['effect']} would make the error {number(-100.0 * row['change'], 2)} % smaller, "
            f"which these records do not make certain (p = {number(row['p_value'], 2)}). To see "
            f"whether it is there: {effect.experiment if effect else ''}".rstrip()
        )
    if verdict == "unexplained" and is_full(claims, settings):
        steps.append(
            f"Search again with more effects: the search ended with as many as max_effects = "
            f"{settings['max_effects']} allows."
        )
    elif verdict == "unexplained":
        step = "Record more of what no effect explains"
        where = looks(location)
        steps.append(
            f"{step}: it is strongest {where}."
            if where
            else f"{step}, and repeat one record exactly: what returns is structure, what does "
            "not is noise."
        )
    if advice:
        where = f" What is left is largest {looks(location)}." if looks(location) else ""
        steps.append(f"{advice[0].upper()}{advice[1:]}.{where}")
    if verdict != "noise" or any(claim["ambiguous_with"] for claim in claims):
        steps.append(
            "Record next, as a file: skhyst.diagnosis.next_experiment, or skhyst next on the "
            "command line, proposes the drive within your limits that tells most of this."
        )
    if faults:
        steps.append("Mend the faults of the recording listed under Data, and search again.")
    return steps
