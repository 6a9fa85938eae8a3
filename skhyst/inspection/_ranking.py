"""The candidates of one round of a search, best first."""

from typing import Self

import numpy as np

from .._documentation import documented_like
from ._base import Display, SignalDisplay, signal_names
from ._drawing import COLORS, FLOOR, INK, MUTED, new_axes, plain, tidy


class EffectRankingDisplay(Display):
    """Candidates of a round: held-out error with each, against the error without and the noise.

    Make one with :meth:`from_search`. All parameters are kept as attributes. A filled mark is a
    claimed effect, an open mark one that was contested (refitted jointly and compared on held-out
    data) and not claimed. Effects below them explained too little of the residual to be contested:
    only the fraction of the power of the residual that they explain to first order is given.

    Parameters
    ----------
    ranking : DataFrame
        Columns ``effect``, ``screen``, ``error_before``, ``error_after``, ``p_value``,
        ``claimed``; one row per candidate.
    noise_floor : float or None, default=None
        Error below which no model can be, unit of the response.
    ambiguous_with : sequence of str, default=()
        Contested effects that the data cannot distinguish from the claimed one.
    response_name : str, default="response"
        Name for the axis.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.inspection import EffectRankingDisplay
    >>> ranking = pd.DataFrame({
    ...     "effect": ["creep", "delay"], "screen": [0.8, 0.01], "error_before": [2.0, 2.0],
    ...     "error_after": [0.5, float("nan")], "p_value": [0.001, float("nan")],
    ...     "claimed": [True, False]})
    >>> display = EffectRankingDisplay(ranking, noise_floor=0.4).plot()
    >>> [label.get_text() for label in display.ax_.get_yticklabels()]
    ['creep', 'delay']
    """

    def __init__(self, ranking, *, noise_floor=None, ambiguous_with=(), response_name="response"):
        self.ranking = ranking
        self.noise_floor = noise_floor
        self.ambiguous_with = ambiguous_with
        self.response_name = response_name

    @classmethod
    @documented_like(SignalDisplay.from_search)
    def from_search(cls, search, *, round=1, ax=None, draw=True, **plot_options) -> Self:
        """Draw one round of a fitted search.

        Parameters
        ----------
        round : int, default=1
            The round, counted from 1.

        Raises
        ------
        ValueError
            If the search had no such round.
        """
        rounds = [int(number) for number in search.ranking_["round"].unique()]
        if round not in rounds:
            raise ValueError(
                f"The 'round' parameter of EffectRankingDisplay.from_search must be one of "
                f"{rounds}. Got {round!r} instead."
            )
        ranking = search.ranking_[search.ranking_["round"] == round]
        claimed = ranking.loc[ranking["claimed"].astype(bool), "effect"]
        history = search.history_
        ambiguous = history.loc[history["effect"].isin(claimed), "ambiguous_with"]
        display = cls(
            ranking.reset_index(drop=True),
            noise_floor=float(search.noise_floor_),
            ambiguous_with=tuple(name for names in ambiguous for name in names),
            response_name=signal_names(search)[1],
        )
        return display.plot(ax=ax, **plot_options) if draw else display

    @documented_like(Display.plot)
    def plot(self, ax=None, *, title=None) -> Self:
        """Draw the candidates.

        Parameters
        ----------
        title : str or None, default=None
            Title of the picture.
        """
        table = self.ranking.sort_values(
            ["error_after", "screen"], ascending=[True, False], na_position="last", kind="stable"
        )
        size = (7.0, 1.2 + 0.3 * len(table))
        axes = new_axes(ax, 1, 1, "EffectRankingDisplay", size=size)[0, 0]
        heights = np.arange(len(table))[::-1]
        baseline = float(table["error_before"].iloc[0])
        left, right = self._limits(table, baseline)
        self._draw_references(axes, baseline, len(table) - 0.35)
        tidy(axes, title=title, x_label=f"held-out error of {self.response_name} (RMS)")
        axes.set_yticks(heights, [plain(name) for name in table["effect"]])
        rows = zip(heights, axes.get_yticklabels(), table.itertuples(), strict=True)
        for height, label, row in rows:
            label.set_fontweight("bold" if row.claimed else "normal")
            label.set_color(INK if np.isfinite(row.error_after) else MUTED)
            self._draw_row(axes, height, row, baseline, right)
        axes.set_ylim(-0.6, len(table) + 0.25)
        axes.set_xlim(left, right)
        axes.grid(False, axis="y")
        axes.tick_params(axis="y", length=0)
        self.ax_, self.figure_ = axes, axes.figure
        return self

    def _limits(self, table, baseline):
        """Return the ends of the error axis: from zero, unless all errors are far above it."""
        shown = [baseline, *table["error_after"].dropna()]
        if self.noise_floor is not None and np.isfinite(self.noise_floor):
            shown.append(self.noise_floor)
        lowest = min(shown)
        if lowest < 0.7 * baseline:
            return 0.0, 1.18 * baseline
        reach = max(1.15 * (baseline - lowest), 0.05 * baseline)
        return baseline - reach, baseline + reach

    def _draw_references(self, axes, baseline, top):
        """Draw the error without any candidate, and the noise floor."""

        def label(error, text, side, color):
            place = {"xytext": (3 if side == "left" else -3, 0), "textcoords": "offset points"}
            style = {"color": color, "ha": side, "va": "bottom"}
            axes.annotate(text, (error, top), **place, **style)

        axes.axvline(baseline, color=INK, linewidth=1.0)
        below = self.noise_floor is None or not self.noise_floor > baseline
        label(baseline, "without", "left" if below else "right", INK)
        if self.noise_floor is not None and np.isfinite(self.noise_floor):
            axes.axvline(self.noise_floor, color=FLOOR, linewidth=1.4, linestyle=":", zorder=3)
            side = "left" if self.noise_floor < 0.25 * baseline or not below else "right"
            label(self.noise_floor, "noise floor", side, FLOOR)

    def _draw_row(self, axes, height, row, baseline, right):
        """Draw the mark of one candidate and the numbers at the end of its row."""
        share = f"{100.0 * row.screen:.0f} %" if row.screen >= 0.01 else "< 1 %"
        note = {"va": "center", "transform": axes.get_yaxis_transform()}
        if not np.isfinite(row.error_after):
            axes.text(1.02, height, f"explains {share}, not contested", color=MUTED, **note)
            return
        color = COLORS[1] if row.claimed or row.effect in self.ambiguous_with else COLORS[0]
        error = min(row.error_after, 0.985 * right)
        marker, filling = ">" if error < row.error_after else "o", color if row.claimed else "none"
        axes.plot([baseline, error], [height, height], color=color, linewidth=1.6, alpha=0.55)
        style = {"color": color, "markerfacecolor": filling, "markersize": 7, "clip_on": False}
        axes.plot(error, height, marker, **style)
        words = f"explains {share}"
        if np.isfinite(row.p_value):
            words += f", p = {row.p_value:.2g}"
        if row.claimed:
            words += ", claimed"
        elif row.effect in self.ambiguous_with:
            words += ", fits as well"
        axes.text(1.02, height, words, color=INK, **note)
