"""Drive against response, with the loop of the model."""

from typing import Self

import numpy as np

from .._documentation import documented_like
from ._base import SignalDisplay
from ._drawing import COLORS, MEASURED, legend_right, new_axes, tidy


class HysteresisLoopDisplay(SignalDisplay):
    """Hysteresis loops: measured, and as models predict them.

    Make one with :meth:`from_estimator`, :meth:`from_predictions` or :meth:`from_search`. All
    parameters are kept as attributes.

    Attributes
    ----------
    ax_ : matplotlib Axes or ndarray of Axes
        Axes of the picture: one Axes for each model if they are side by side.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import HysteresisLoopDisplay
    >>> time = np.linspace(0, 1, 500)
    >>> drive = np.sin(2 * np.pi * 3 * time)
    >>> response = drive + 0.1 * np.cos(2 * np.pi * 3 * time)
    >>> display = HysteresisLoopDisplay.from_predictions(drive[:, None], response, drive)
    >>> display.ax_.get_xlabel(), display.ax_.get_ylabel()
    ('drive', 'response')
    """

    @documented_like(SignalDisplay.plot)
    def plot(self, ax=None, *, subtract_line=False, max_cycles=10) -> Self:
        """Draw the loops.

        Parameters
        ----------
        ax : matplotlib Axes, array of Axes or None, default=None
            One Axes: all models over each other. As many Axes as models: one model each. None: a
            new figure with one Axes for each model.
        subtract_line : bool, default=False
            Subtract the best straight line through the measured response from everything. The loop
            opens, and differences of a percent of the range become visible.
        max_cycles : int, default=10
            Cycles of the drive to draw. In a longer recording, each record is cut to
            complete cycles around its largest excursion.
        """
        n_models = len(self.predictions)
        one = ax is not None and np.size(np.asarray(ax, dtype=object)) == 1
        n_panels = 1 if one else max(n_models, 1)
        shared = {"size": (1.0 + 4.2 * n_panels, 4.2), "sharex": True, "sharey": True}
        axes = new_axes(ax, 1, n_panels, "HysteresisLoopDisplay", **shared).ravel()
        line = self._straight_line() if subtract_line else np.zeros(len(self.drive))
        for panel in axes:
            style = {"color": MEASURED, "linewidth": 2.0, "solid_joinstyle": "round"}
            part = self._draw_loops(panel, self.response - line, max_cycles, "measured", **style)
        panels = axes if n_panels == n_models else np.repeat(axes, n_models)
        for k, (label, prediction) in enumerate(self.predictions.items()):
            style |= {"color": COLORS[k % len(COLORS)], "linewidth": 0.8}
            self._draw_loops(panels[k], prediction - line, max_cycles, label, **style)
        y_label = self.response_name + (" less its straight line" if subtract_line else "")
        shown = {}
        for k, panel in enumerate(axes):
            first = {"title": part, "y_label": y_label} if k == 0 else {}
            tidy(panel, x_label=self.drive_name, **first)
            for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
                shown.setdefault(label, handle)
        legend_right(axes[-1], list(shown.values()), list(shown))
        self.ax_ = axes[0] if n_panels == 1 else axes
        self.figure_ = axes[0].figure
        return self

    def _straight_line(self):
        """Return the least-squares line through the measured points, shape (n_samples,)."""
        centred = self.drive - np.mean(self.drive)
        slope = np.dot(centred, self.response) / max(np.dot(centred, centred), np.finfo(float).tiny)
        return np.mean(self.response) + slope * centred
