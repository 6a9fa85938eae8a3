"""A recording: its signals over time, and its loop."""

import numpy as np

from .._documentation import documented_like
from ._base import SignalDisplay
from ._drawing import COLORS, MEASURED, import_matplotlib, tidy

_POINTS = 2000  # drawn of a signal


class RecordingDisplay(SignalDisplay):
    """Drive and response over time, and one against the other.

    Make one with :meth:`from_recording`. All parameters are kept as attributes.

    Attributes
    ----------
    ax_ : ndarray of Axes of shape (3,)
        Drive, response, loop.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import RecordingDisplay
    >>> drive = np.sin(np.linspace(0, 30, 2000))
    >>> display = RecordingDisplay.from_recording(drive[:, None], drive**3)
    >>> [ax.get_ylabel() for ax in display.ax_]
    ['drive', 'response', 'response']
    """

    @classmethod
    @documented_like(SignalDisplay.from_predictions)
    def from_recording(cls, X, y, *, dt=None, ax=None, **plot_options):
        """Draw a recording."""
        return cls.from_predictions(X, y, {}, dt=dt, ax=ax, **plot_options)

    @documented_like(SignalDisplay.plot)
    def plot(self, ax=None, *, max_cycles=10):
        """Draw the recording.

        Parameters
        ----------
        ax : matplotlib Axes or None, default=None
            It is divided; None makes a new figure.
        max_cycles : int, default=10
            Cycles of the loop to draw, around the largest excursion of every record.
        """
        pyplot = import_matplotlib("pyplot", "RecordingDisplay")
        figure = pyplot.figure(figsize=(11.0, 4.6), layout="constrained") if ax is None else None
        host = figure.add_subplot() if ax is None else ax
        host.set_axis_off()
        grid = host.get_subplotspec().subgridspec(2, 2, width_ratios=(1.6, 1.0))
        upper = host.figure.add_subplot(grid[0, 0])
        lower = host.figure.add_subplot(grid[1, 0], sharex=upper)
        loop = host.figure.add_subplot(grid[:, 1])
        signals = (upper, self.drive, COLORS[1]), (lower, self.response, COLORS[0])
        for panel, values, color in signals:
            self._draw_in_time(panel, values, _POINTS, color=color, linewidth=0.9)
            self._mark_records(panel)
        part = self._draw_loops(loop, self.response, max_cycles, color=MEASURED, linewidth=1.0)
        tidy(upper, y_label=self.drive_name)
        tidy(lower, x_label=self.units.label("time (s)"), y_label=self.response_name)
        tidy(loop, title=part, x_label=self.drive_name, y_label=self.response_name)
        self.ax_, self.figure_ = np.array([upper, lower, loop]), host.figure
        return self
