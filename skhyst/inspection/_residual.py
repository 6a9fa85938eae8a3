"""Residuals of models: in time, against drive and prediction, and their spectra."""

from typing import Self

import numpy as np

from .._documentation import documented_like
from ..records import by_interval
from ._base import SignalDisplay
from ._drawing import COLORS, FLOOR, INK, MUTED, legend_right, new_axes, plain, tidy
from ._plot_data import binned_statistics, branch, spectrum

KINDS = ("time", "drive", "prediction", "spectrum")


class ResidualDisplay(SignalDisplay):
    """Residuals of models: measured response minus prediction.

    Make one with :meth:`from_estimator`, :meth:`from_predictions` or :meth:`from_search`. All
    parameters are kept as attributes.

    Four pictures: the residual in time; its mean against the drive and against the prediction,
    separately for the rising and the falling branch; and its amplitude spectral density. Noise is
    flat in all of them. Remaining hysteresis or asymmetry separates the branches, a memoryless
    nonlinearity bends both alike against the prediction, and a missing mode is a peak in the
    spectrum.

    Parameters
    ----------
    noise_floor : float or None, default=None
        Error below which no model can be, unit of the response; drawn as a flat spectrum.

    Attributes
    ----------
    ax_ : matplotlib Axes or ndarray of Axes of shape (2, 2)
        Axes of the picture.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import ResidualDisplay
    >>> drive = np.sin(np.linspace(0, 30, 2000))
    >>> response = drive + 0.1 * drive**2
    >>> display = ResidualDisplay.from_predictions(drive[:, None], response, drive)
    >>> display.ax_.shape
    (2, 2)
    >>> display.residuals()["model"].max().round(2)
    np.float64(0.1)
    """

    def residuals(self) -> dict[str, np.ndarray]:
        """Return model name -> residual, arrays of shape (n_samples,), NaN where not scored."""
        return {name: self.response - values for name, values in self.predictions.items()}

    @documented_like(SignalDisplay.plot)
    def plot(self, ax=None, *, kind="all", max_points=2000) -> Self:
        """Draw the residuals.

        Parameters
        ----------
        ax : matplotlib Axes, array of Axes or None, default=None
            Where to draw. For ``kind="all"`` an Axes is divided into four, and four may be given.
        kind : {"all", "time", "drive", "prediction", "spectrum"}, default="all"
            Which picture.
        max_points : int, default=2000
            Points to draw for each curve in time; a longer one is drawn by its outline, which
            keeps every peak.

        Raises
        ------
        ValueError
            If ``kind`` is none of these.
        """
        if kind != "all" and kind not in KINDS:
            raise ValueError(
                f"The 'kind' parameter of ResidualDisplay.plot must be one of "
                f"{('all', *KINDS)}. Got {kind!r} instead."
            )
        kinds = KINDS if kind == "all" else (kind,)
        side = 2 if kind == "all" else 1
        size = (9.0, 6.4) if kind == "all" else (6.0, 4.0)
        axes = new_axes(ax, side, side, "ResidualDisplay", size=size)
        for place, (panel, name) in enumerate(zip(axes.ravel(), kinds, strict=True)):
            if name == "time":
                self._plot_time(panel, max_points)
            elif name == "spectrum":
                self._plot_spectrum(panel)
            else:
                self._plot_branches(panel, name)
            if place % side == side - 1:  # on the right the legends of each row
                legend_right(panel, *self._legend(panel, name))
        self.ax_ = axes if kind == "all" else axes[0, 0]
        self.figure_ = axes[0, 0].figure
        return self

    def _colored(self):
        for k, (name, values) in enumerate(self.residuals().items()):
            yield name, values, COLORS[k % len(COLORS)]

    def _plot_time(self, ax, max_points):
        for name, values, color in self._colored():
            self._draw_in_time(ax, values, max_points, name, color=color, linewidth=0.7)
        self._mark_records(ax)
        x_label = self.units.label("time (s)")
        tidy(ax, title="In time", x_label=x_label, y_label=f"residual of {self.response_name}")

    def _plot_branches(self, ax, against):
        direction = np.concatenate([branch(self.drive[span]) for span in self.spans])
        for name, values, color in self._colored():
            x = self.drive if against == "drive" else self.predictions[name]
            for sign, style, side in ((1, "-", "rising"), (-1, "--", "falling")):
                chosen = direction == sign
                center, mean, std = binned_statistics(x[chosen], values[chosen])
                ax.plot(center, mean, style, color=color, linewidth=1.3, label=side)
                ax.fill_between(center, mean - std, mean + std, color=color, alpha=0.13, lw=0)
        ax.axhline(0.0, color=MUTED, linewidth=0.6)
        name = self.drive_name if against == "drive" else f"predicted {self.response_name}"
        title = f"Against {against}, by branch"
        tidy(ax, title=title, x_label=name, y_label=f"residual of {self.response_name}")

    def _legend(self, ax, name):
        """Return handles and labels: of the models, or of the branches."""
        if name not in ("drive", "prediction"):
            return ax.get_legend_handles_labels()
        handles = [ax.plot([], [], style, color=INK, linewidth=1.2)[0] for style in ("-", "--")]
        return handles, ["rising drive", "falling drive"]

    def _plot_spectrum(self, ax):
        groups = by_interval(self.records)
        floor = {"color": FLOOR, "linewidth": 1.4, "label": "noise floor"}
        for dt, numbers in groups.items():
            spans = [self.spans[i] for i in numbers]
            every = f", every {dt:.3g} s" if len(groups) > 1 else ""
            for name, values, color in self._colored():
                frequency, density = spectrum(values, spans, dt, per_decade=40)
                label = f"{plain(name)}{every}"
                ax.loglog(frequency, density, color=color, linewidth=1.0, label=label)
            if self.noise_floor is not None and frequency.size:
                level = self.noise_floor * np.sqrt(2.0 * dt)
                ax.plot([frequency[0], frequency[-1]], [level, level], ":", **floor)
                floor["label"] = None
        unit = "(response/√Hz)" if self.units.response else "per √Hz"
        labels = [self.units.label(text) for text in ("frequency (Hz)", f"residual {unit}")]
        tidy(ax, title="Spectrum", x_label=labels[0], y_label=self.units.in_time(labels[1]))
