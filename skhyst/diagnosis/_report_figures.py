"""Pictures of a report, as SVG text that stands inside a page."""

import numpy as np
import pandas as pd

from ..inspection import (
    EffectRankingDisplay,
    EvidenceDisplay,
    HysteresisLoopDisplay,
    PredictionDisplay,
    ResidualDisplay,
    svg_text,
)

_WIDTH = 7.4  # inches


def report_figures(report):
    """Draw every picture: ``course``, ``loops``, ``residuals``, one a round and one a claim.

    One of a round is empty where nothing was contested.
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

    def course(figure):
        PredictionDisplay(**report.signals).plot(ax=figure.subplots(2, 1))

    return {
        "course": svg_text(course, (_WIDTH, 4.6), "Response over time, measured and modelled"),
        "loops": svg_text(loops, (_WIDTH, 6.4), "Loops, measured and modelled"),
        "residuals": svg_text(
            residuals, (_WIDTH, 5.6), "Residuals in time, by branch, and spectrum"
        ),
        "rankings": [_ranking(report, number) for number in report.rounds],
        "evidence": [_evidence(claim) for claim in report.claims],
    }


def _ranking(report, number):
    """Draw one round of candidates; nothing where none was contested."""
    rows = pd.DataFrame([row for row in report.ranking if row["round"] == number])
    if not np.isfinite(rows["error_after"]).any():
        return ""
    claimed = set(rows.loc[rows["claimed"], "effect"])
    claims = [claim for claim in report.claims if claim["effect"] in claimed]
    display = EffectRankingDisplay(
        rows,
        noise_floor=report.noise_floor,
        ambiguous_with=[name for claim in claims for name in claim["ambiguous_with"]],
        response_name=report.response_name,
    )
    size = (_WIDTH, 0.95 + 0.24 * len(rows))
    return svg_text(lambda figure: display.plot(ax=figure.subplots()), size, f"Round {number}")


def _evidence(claim):
    """Draw the picture of one claim."""
    picture = claim["picture"]
    size = (_WIDTH, 3.4 if picture.below is None else 5.4)
    display = EvidenceDisplay(picture)
    label = f"Evidence for {claim['effect']}"
    return svg_text(lambda figure: display.plot(ax=figure.subplots()), size, label)
