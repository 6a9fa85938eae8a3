"""The response over time, measured and predicted."""

from typing import Self

import numpy as np

from .._documentation import documented_like
from ._base import SignalDisplay
from ._drawing import COLORS, MEASURED, legend_right, new_axes, tidy


class PredictionDisplay(SignalDisplay):
    """Measured and predicted response over time: all of it, and around the largest error.

    Make one with :meth:`from_estimator`, :meth:`from_predictions` or :meth:`from_search`. All
    parameters are kept as attributes.

    Attributes
    ----------
    ax_ : ndarray of Axes of shape (2,)
        Axes of the picture.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import PredictionDisplay
    >>> drive = np.sin(np.linspace(0, 30, 2000))
    >>> response = drive + 0.1 * (np.arange(2000) == 700)
    >>> display = PredictionDisplay.from_predictions(drive[:, None], response, drive)
    >>> display.furthest_off(100)
    slice(650, 750, None)
    """

    def furthest_off(self, n_samples) -> slice:
        """Return the rows around the largest error of the first model, within one record.

        Parameters
        ----------
        n_samples : int
            Number of rows, fewer in a shorter record.

        Returns
        -------
        slice
            The rows.
        """
        error = np.abs(self.response - next(iter(self.predictions.values())))
        worst = int(np.argmax(np.nan_to_num(error)))
        span = next(own for own in self.spans if own.start <= worst < own.stop)
        start = max(min(worst - n_samples // 2, span.stop - n_samples), span.start)
        return slice(start, min(start + n_samples, span.stop))

    @documented_like(SignalDisplay.plot)
    def plot(self, ax=None, *, max_points=2000, n_samples=400) -> Self:
        """Draw the response.

        Parameters
        ----------
        ax : array of Axes or None, default=None
            Two Axes, or one that is divided; None makes a new figure.
        max_points : int, default=2000
            Points to draw for each curve; a longer one is drawn by its outline.
        n_samples : int, default=400
            Samples in the lower picture, around the largest error of the first model.
        """
        axes = new_axes(ax, 2, 1, "PredictionDisplay", size=(9.0, 5.6))[:, 0]
        time = self.running_time()
        signals = {"measured": self.response} | self.predictions
        styles = [(MEASURED, 2.2), *((color, 0.9) for color in COLORS)]
        for k, (name, values) in enumerate(signals.items()):
            color, width = styles[0] if k == 0 else styles[1 + (k - 1) % len(COLORS)]
            style = {"color": color, "linewidth": width}
            self._draw_in_time(axes[0], values, max_points, name, **style)
            rows = self.furthest_off(n_samples)
            axes[1].plot(time[rows], values[rows], **style)
        self._mark_records(axes[0])
        x_label = self.units.label("time (s)")
        tidy(axes[0], title="All records", y_label=self.response_name)
        title = f"Where {next(iter(self.predictions))} is furthest off"
        tidy(axes[1], title=title, x_label=x_label, y_label=self.response_name)
        axes[1].margins(x=0.01)
        legend_right(axes[0])
        self.ax_, self.figure_ = axes, axes[0].figure
        return self
