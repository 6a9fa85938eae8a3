"""Pictures of a report, as SVG text that stands inside a page.

The pictures take ink and paper from the page (CSS variables ``--ink`` and ``--paper``), so that
they are readable on a dark page too.
"""

import io
import re
import warnings
from types import SimpleNamespace

import numpy as np
import pandas as pd

from ..inspection import (
    EffectRankingDisplay,
    EvidenceDisplay,
    HysteresisLoopDisplay,
    ResidualDisplay,
)
from ..inspection._drawing import INK, import_matplotlib

__all__ = ["report_figures"]

PAPER = "#fdfdfe"
WIDTH = 7.4  # inches


def report_figures(report):
    """Draw every picture of a report.

    Parameters
    ----------
    report : Report

    Returns
    -------
    dict of str to (str or list of str)
        ``"loops"``, ``"residuals"``: one SVG each; ``"rankings"``, ``"evidence"``: lists, one a
        round (empty where nothing was contested) and one a claim.
    """
    panels = len(report.signals["predictions"])

    def loops(figure):
        axes = figure.subplots(2, panels, squeeze=False, sharex=True, sharey="row")
        for row, subtract in zip(axes, (False, True), strict=True):
            ax = row if panels > 1 else row[0]
            HysteresisLoopDisplay(**report.signals).plot(ax=ax, subtract_line=subtract)
        for ax in axes[0]:
            ax.set_xlabel("")

    def residuals(figure):
        ResidualDisplay(**report.signals).plot(ax=figure.subplots(2, 2))

    return {
        "loops": _svg(loops, (WIDTH, 6.4), "Loops, measured and modelled"),
        "residuals": _svg(residuals, (WIDTH, 5.6), "Residuals in time, by branch, and spectrum"),
        "rankings": [_ranking(report, number) for number in report.rounds],
        "evidence": [_evidence(claim) for claim in report.claims],
    }


def _ranking(report, number):
    """Draw one round of candidates; nothing where none was contested."""
    rows = pd.DataFrame([row for row in report.ranking if row["round"] == number])
    if not np.isfinite(rows["error_after"]).any():
        return ""
    claimed = set(rows.loc[rows["claimed"], "effect"])
    ambiguous = [
        name
        for claim in report.claims
        if claim["effect"] in claimed
        for name in claim["ambiguous_with"]
    ]
    display = EffectRankingDisplay(
        rows,
        noise_floor=report.noise_floor,
        ambiguous_with=ambiguous,
        response_name=report.response_name,
    )
    size = (WIDTH, 0.95 + 0.24 * len(rows))
    return _svg(lambda figure: display.plot(ax=figure.subplots()), size, f"Round {number}")


def _evidence(claim):
    """Draw the picture of one claim."""
    picture = dict(claim["picture"])
    picture["curves"] = [
        (curve["label"], np.array(curve["x"], float), np.array(curve["y"], float), curve["style"])
        for curve in picture["curves"]
    ]
    display = EvidenceDisplay(SimpleNamespace(**picture))
    return _svg(
        lambda figure: display.plot(ax=figure.subplots()),
        (WIDTH, 3.4),
        f"Evidence for {claim['effect']}",
    )


def _svg(draw, size, label):
    """Draw with ``draw(figure)`` and return the SVG element, without identifiers of its own."""
    matplotlib = import_matplotlib("pyplot", "The pictures of a report")
    from matplotlib.figure import Figure

    style = {
        "svg.fonttype": "none",
        "svg.hashsalt": label,
        "font.size": 9.0,
        "text.color": INK,
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "axes.facecolor": PAPER,
        "legend.facecolor": PAPER,
        "legend.edgecolor": "none",
        "axes.unicode_minus": True,
    }
    with matplotlib.rc_context(style), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        text = io.StringIO()
        figure.savefig(
            text,
            format="svg",
            facecolor="none",
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'^<svg\b[^>]*?viewBox="([^"]*)"[^>]*>', _opening(label), svg, count=1)
    svg = re.sub(r"(font:[^;\"]*?)'DejaVu Sans'[^;\"]*", r"\1var(--sans)", svg)
    return svg.replace(INK, "var(--ink)").replace(PAPER, "var(--paper)")


def _opening(label):
    """Return the opening tag of a picture, as a replacement for ``re.sub``."""
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        rf'viewBox="\1" role="img" aria-label="{label}">'
    )
