"""From a fitted search to the plain data of a report."""

from types import SimpleNamespace

import numpy as np

from ..inspection._base import search_labels, signal_names
from ..inspection._signals import log_average, spectrum, thin_path
from ._effects import EFFECTS
from ._location import locate
from ._report import package_versions
from ._report_text import next_steps

__all__ = ["collect"]

_SETTINGS = (
    "alpha",
    "max_effects",
    "min_improvement",
    "cv",
    "folds",
    "loss",
    "washout",
    "random_state",
)
_MAX_CURVE = 4000
_CONCENTRATED = 1.5  # mean power over that of the whole, above which a place is named


def collect(search, command, held_out):
    """Return the fields of a :class:`skhyst.diagnosis.Report`, by name."""
    names = signal_names(search)
    response = np.asarray(search.response_, dtype=float)
    label_before, label_after = search_labels(search)
    predictions = {label_before: np.asarray(search.prediction_before_, dtype=float)}
    if search.effects_:
        predictions[label_after] = np.asarray(search.prediction_after_, dtype=float)
    ranking = _ranking(search.ranking_)
    claims = [_claim(row, search.evidence_) for row in search.history_.itertuples()]
    not_it, location = (
        _not_it(ranking, claims),
        _location(search.residual_location_, search.records_),
    )
    data = _data(search, response)
    return {
        "declared_model": _spelled(search.declared_estimator_),
        "augmented_model": _spelled(search.best_estimator_),
        "effects": [str(effect) for effect in search.effects_],
        "verdict": str(search.verdict_),
        "error_before": float(search.error_before_),
        "error_after": float(search.error_after_),
        "noise_floor": float(search.noise_floor_),
        "response_range": float(np.ptp(response)),
        "drive_name": names.drive,
        "response_name": names.response,
        "claims": claims,
        "ranking": ranking,
        "not_it": not_it,
        "parameters": {
            "declared": _parameters(search.declared_estimator_),
            "augmented": _parameters(search.best_estimator_),
        },
        "data": data,
        "settings": {
            name: _setting(getattr(search, name)) for name in _SETTINGS if hasattr(search, name)
        },
        "held_out": _held_out(search, held_out),
        "versions": package_versions(),
        "seconds": {str(stage): float(value) for stage, value in search.seconds_.items()},
        "command": command,
        "spectra": _spectra(search),
        "location": location,
        "declared_location": _location(_declared_location(search), search.records_),
        "dropped": [str(name) for name in search.dropped_],
        "next_steps": next_steps(
            claims, not_it, location, search.verdict_, data["faults"], search.alpha, _experiments()
        ),
        "signals": {
            "drive": np.asarray(search.drive_, dtype=float),
            "response": response,
            "predictions": predictions,
            "records": tuple(search.records_),
            "drive_name": names.drive,
            "response_name": names.response,
            "noise_floor": float(search.noise_floor_),
        },
    }


def _experiments():
    """Return the experiment that shows each effect best."""
    return {name: effect.experiment for name, effect in EFFECTS.items()}


def _declared_location(search):
    """Return where what the declared model leaves stands, as ``residual_location_`` does."""
    spans = [record.rows for record in search.records_]
    records = [
        SimpleNamespace(u=search.drive_[span], dt=record.dt)
        for span, record in zip(spans, search.records_, strict=True)
    ]
    residuals = [search.residual_before_[span] for span in spans]
    return locate(records, residuals, [record.label for record in search.records_])


def _spelled(estimator):
    """Write an estimator on one line."""
    return " ".join(repr(estimator).split())


def _setting(value):
    """Keep plain values, write everything else."""
    return value if value is None or isinstance(value, str | bool | int | float) else repr(value)


def _claim(row, evidence):
    """Return one claim: a row of the history with its evidence."""
    found = evidence[row.effect]
    picture = found.picture
    return {
        "effect": str(row.effect),
        "law": EFFECTS[row.effect].law if row.effect in EFFECTS else "",
        "error_before": float(row.error_before),
        "error_after": float(row.error_after),
        "p_value": float(row.p_value),
        "ambiguous_with": [str(name) for name in row.ambiguous_with],
        "experiment": str(row.experiment),
        "statement": str(found.statement),
        "numbers": [
            {"name": str(name), "value": float(value), "std": float(std), "unit": str(unit)}
            for name, (value, std, unit) in found.numbers.items()
        ],
        "picture": {
            "title": str(picture.title),
            "x_label": str(picture.x_label),
            "y_label": str(picture.y_label),
            "x_log": bool(picture.x_log),
            "y_log": bool(picture.y_log),
            "curves": [_curve(*curve) for curve in picture.curves],
        },
    }


def _curve(label, x, y, style):
    """Return a curve of a picture, by its outline where it is long."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    kept = thin_path(x, y, _MAX_CURVE)
    return {"label": str(label), "style": str(style), "x": x[kept].tolist(), "y": y[kept].tolist()}


def _ranking(table):
    """Return the rows of the ranking in the order of the rounds, best first."""
    table = table.sort_values(
        ["round", "error_after", "screen"],
        ascending=[True, True, False],
        na_position="last",
        kind="stable",
    )
    return [
        {
            "round": int(row.round),
            "effect": str(row.effect),
            "screen": float(row.screen),
            "error_before": float(row.error_before),
            "error_after": float(row.error_after),
            "p_value": float(row.p_value),
            "n_parameters": int(row.n_parameters),
            "claimed": bool(row.claimed),
        }
        for row in table.itertuples()
    ]


def _not_it(ranking, claims):
    """Return, for each effect not claimed, the contest in which it helped most, best first.

    An effect that was never contested appears with the largest share of the residual's power that
    it explained in any round. Effects that fit as well as a claimed one are left out.
    """
    excluded = {name for claim in claims for name in (claim["effect"], *claim["ambiguous_with"])}
    rows = []
    for effect in dict.fromkeys(row["effect"] for row in ranking):
        if effect in excluded:
            continue
        tries = [row for row in ranking if row["effect"] == effect]
        contested = [row for row in tries if np.isfinite(row["error_after"])]
        best = (
            min(contested, key=lambda row: row["error_after"] / row["error_before"])
            if contested
            else max(tries, key=lambda row: row["screen"])
        )
        winner = next(
            (row for row in ranking if row["round"] == best["round"] and row["claimed"]), None
        )
        rows.append(
            {
                **{key: best[key] for key in ("effect", "round", "screen", "p_value")},
                "error_before": best["error_before"],
                "error_after": best["error_after"],
                "change": best["error_after"] / best["error_before"] - 1.0,
                "claimed_instead": None if winner is None else winner["effect"],
                "claimed_error": float("nan") if winner is None else winner["error_after"],
            }
        )
    rows.sort(key=lambda row: (not np.isfinite(row["change"]), row["change"], -row["screen"]))
    return rows


def _parameters(estimator):
    """Return the parameters of a model, one row a value, with standard errors where known."""
    values = getattr(estimator, "params_", {})
    errors = getattr(estimator, "params_std_", {})
    rows = []
    for name, value in values.items():
        value = np.asarray(value, dtype=float)
        std = np.broadcast_to(np.asarray(errors.get(name, np.nan), dtype=float), value.shape)
        for k, (item, error) in enumerate(zip(value.ravel(), std.ravel(), strict=True)):
            rows.append(
                {
                    "name": str(name) if value.ndim == 0 else f"{name}[{k}]",
                    "value": float(item),
                    "std": float(error),
                    "note": _note(float(error)),
                }
            )
    return rows


def _note(std):
    """Say why a parameter has no standard error."""
    if np.isinf(std):
        return "not determined"
    return "at a bound" if np.isnan(std) else ""


def _data(search, response):
    """Return what the recording is: records, samples, interval, ranges."""
    drive = np.asarray(search.drive_, dtype=float)
    records = [
        {
            "label": str(record.label),
            "n_samples": int(record.n_samples),
            "start_time": float(record.start_time),
            "duration": float(record.dt * record.n_samples),
            "drive_min": float(drive[record.rows].min()),
            "drive_max": float(drive[record.rows].max()),
            "response_min": float(response[record.rows].min()),
            "response_max": float(response[record.rows].max()),
        }
        for record in search.records_
    ]
    return {
        "n_records": len(records),
        "n_samples": len(response),
        "n_scored": int(np.count_nonzero(np.isfinite(search.residual_before_))),
        "n_inputs": int(search.n_features_in_),
        "interval": float(search.records_[0].dt),
        "records": records,
        "faults": [
            {
                "fault": row.fault,
                "record": str(row.record),
                "n_samples": int(row.n_samples),
                "rows": [int(i) for i in row.rows],
                "advice": row.advice,
            }
            for row in search.data_quality_.itertuples()
        ],
    }


def _held_out(search, held_out):
    """Return the errors of both models on data that the search has not seen."""
    if held_out is None:
        return None
    X, y = held_out
    response = np.asarray(y, dtype=float)
    return {
        "n_samples": len(response),
        "response_range": float(np.ptp(response)),
        "error_before": float(search.held_out_error(X, y, declared=True)),
        "error_after": float(search.held_out_error(X, y)),
    }


def _location(table, slices):
    """Return the strongest entry of each way to look at what is left."""
    labels = {s.label: str(s.label) for s in slices}  # the table holds 1 as 1.0
    strongest = table.groupby("by", sort=False).head(1)
    return [
        {
            "by": row.by,
            "record": labels.get(row.record),
            "low": float(row.low),
            "high": float(row.high),
            "unit": row.unit,
            "share": float(row.share),
            "concentration": float(row.concentration),
        }
        for row in strongest.itertuples()
        if row.concentration > _CONCENTRATED
    ]


def _spectra(search):
    """Return the amplitude spectral density of the residual before and after."""
    spans = [record.rows for record in search.records_]
    dt = search.records_[0].dt
    before = np.asarray(search.residual_before_, dtype=float)
    after = np.asarray(search.residual_after_, dtype=float)
    unscored = np.isnan(before) | np.isnan(after)
    result = {}
    for name, values in (("before", before), ("after", after)):
        density = spectrum(np.where(unscored, np.nan, values), spans, dt)
        frequency, density = log_average(*density)
        result["frequency"] = frequency.tolist()
        result[name] = density.tolist()
    return result
