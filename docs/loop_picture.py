"""Draw the loop of the landing page, and write the report of the same search.

A simulated plant with hysteresis and creep, which shares no code with the models, and a search that
is given the recording and the declared model. The build of the pages calls :func:`draw_loop` and
:func:`write_report`. `PYTHONPATH=benchmarks python docs/loop_picture.py` writes what the README
shows: `docs/pictures/loop.png`, `docs/sample_report.md`, and in `docs/reports` what the command
line reports of the other recordings to try.
"""

from contextlib import chdir
from functools import cache, partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from signatures import BOTH, DOWN, GREY, STYLE, UP

from skhyst.app._samples import SAMPLES, sample_recording
from skhyst.cli import main
from skhyst.datasets import steps, triangle
from skhyst.datasets.simulation import Plant, PlantEffect, kelvin_voigt, plays
from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.records import iter_records, stack_records

__all__ = ["draw_loop", "write_report"]

DT = 0.02  # s
NOISE = 0.01  # um
CANDIDATES = ["creep", "lag", "resonance", "drift", "rate_dependence", "static_nonlinearity"]


def _recording():
    """Return two records of steps and two of triangles, um over V."""
    core = partial(plays, thresholds=[0, 3, 8, 15, 25], weights=[0.06, 0.02, 0.015, 0.01, 0.008])
    creep = PlantEffect(
        "dynamics", partial(kelvin_voigt, taus=[0.1, 1.0], compliances=[0.07, 0.09])
    )
    (plant,) = creep.changes([Plant({"core": (core,), "dynamics": ()})])
    rng = np.random.default_rng(0)
    levels = [[0, 40, 10, -35, -10, 25], [0, -30, 20, 45, -20, 5]]
    drives = [steps(some, hold=1.2, dt=DT)["drive"].to_numpy() for some in levels]
    drives += [triangle(a, 1.2, n_cycles=3, dt=DT)["drive"].to_numpy() for a in (45.0, 30.0)]
    responses = [plant.respond(drive, dt=DT) for drive in drives]
    noisy = [response + NOISE * rng.normal(size=response.size) for response in responses]
    X, y = stack_records(list(zip(drives, noisy, strict=True)), dt=DT)
    return X.set_axis(["drive (V)"], axis=1), y.rename("position (µm)")


@cache
def _searched():
    """Return the recording and the search of it."""
    X, y = _recording()
    search = EffectSearchCV(PrandtlIshlinskii(), effects=CANDIDATES, random_state=0)
    return X, y, search.fit(X, y)


def write_report(path):
    """Write the report of the search, as its suffix says: a page, or Markdown."""
    report = _searched()[2].report()
    (report.to_html if path.suffix == ".html" else report.to_markdown)(path)


def draw_loop(path):
    """Draw each step of the loop into a file."""
    X, y, search = _searched()
    (effect,) = search.effects_
    declared = search.declared_estimator_.predict(X)
    _, X_first, y_first = next(iter_records(X, y))
    time, first = DT * np.arange(len(y_first)), slice(0, len(y_first))
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(12.5, 2.7), layout="constrained")
        panels = figure.subplots(1, 5, gridspec_kw={"width_ratios": [1, 1, 1, 1, 0.7]})
        recording, model, residual, named, errors = panels
        drive = X_first.to_numpy()[:, 0]
        recording.plot(time, drive * np.ptp(y_first) / np.ptp(drive), color=GREY, label="drive")
        recording.plot(time, y_first, color=BOTH, label="response")
        model.plot(time, y_first, color=BOTH, label="measured")
        model.plot(time, declared[first], color=UP, lw=1.2, label="predicted")
        residual.plot(time, 1e3 * (y_first - declared[first]), color=UP, lw=0.8)
        tried = search.ranking_[search.ranking_["round"] == 1].sort_values("screen")
        colors = [DOWN if name == effect else GREY for name in tried["effect"]]
        named.barh(tried["effect"].str.replace("_", " "), 100 * tried["screen"], color=colors)
        before, after, floor = (
            1e3 * value
            for value in (search.error_before_, search.error_after_, search.noise_floor_)
        )
        errors.bar(["before", "after"], [before, after], color=[UP, DOWN], width=0.6)
        errors.axhline(floor, color=BOTH, lw=1, ls="--")
        errors.text(1.4, floor, "noise floor", ha="right", va="bottom", fontsize=8, color=BOTH)
        titles = [
            "1  Record",
            "2  Declare a model",
            "3  Look at the residual",
            f"4  Missing: {effect}",
            "5  Error",
        ]
        for axes, title in zip(panels, titles, strict=True):
            axes.set_title(title, loc="left", fontweight="bold", fontsize=10)
        for axes, name in ((recording, "position (µm)"), (model, ""), (residual, "nm")):
            axes.set(xlabel="time (s)", ylabel=name)
        named.set_xlabel("explains of the residual (%)")
        for axes in (recording, model):
            axes.legend(frameon=False, fontsize=8)
        errors.set_ylabel("held out, nm")
        figure.savefig(path, dpi=160, metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    docs = Path(__file__).parent
    draw_loop(docs / "pictures" / "loop.png")
    write_report(docs / "sample_report.md")
    with chdir(docs / "reports"):
        for device in SAMPLES[1:]:
            file, table = sample_recording(device)
            table.to_csv(file, index=False)
            report = str(Path(file).with_suffix(".md"))
            main(["diagnose", file, "--quiet", "--force", "--report", report])
            Path(file).unlink()
