"""Base classes of the displays."""

from abc import ABC, abstractmethod
from itertools import pairwise
from typing import Self

import numpy as np

from .._documentation import documented_like, inherit_documentation
from .._envelope import envelope
from .._validation import interval_of
from ..io import unit_of
from ..records import Units, record_slices, with_lost_rows
from ._drawing import MUTED, plain
from ._plot_data import loop_spans, thin_path

_POINTS = 240  # drawn of a cycle


class Display(ABC):
    """Base of the displays, which store data first and draw afterwards.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Axes of the picture.
    figure_ : matplotlib Figure
    """

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        inherit_documentation(cls)

    @abstractmethod
    def plot(self, ax=None) -> Self:
        """Draw the picture.

        Parameters
        ----------
        ax : matplotlib Axes or None, default=None
            Where to draw; None makes a new figure.

        Returns
        -------
        self
        """


class SignalDisplay(Display):
    """Base of the displays of a recording and the predictions of models.

    Parameters
    ----------
    drive : ndarray of shape (n_samples,)
        Drive, in its own unit.
    response : ndarray of shape (n_samples,)
        Measured response, in its own unit.
    predictions : dict of str to ndarray of shape (n_samples,)
        Model name to prediction, units of the response; NaN if it has none.
    records : sequence of RecordSlice
        The records, as :func:`skhyst.records.record_slices` returns them.
    drive_name, response_name : str, default="drive", "response"
        Names for the axes.
    noise_floor : float or None, default=None
        Error below which no model can be, unit of the response.
    """

    def __init__(
        self,
        *,
        drive,
        response,
        predictions,
        records,
        drive_name="drive",
        response_name="response",
        noise_floor=None,
    ):
        self.drive = drive
        self.response = response
        self.predictions = predictions
        self.records = records
        self.drive_name = drive_name
        self.response_name = response_name
        self.noise_floor = noise_floor

    @classmethod
    def from_estimator(cls, estimator, X, y, *, ax=None, **plot_options) -> Self:
        """Draw the free run of a fitted estimator and the measured response.

        Parameters
        ----------
        estimator : estimator
            Fitted; ``predict(X)`` is called.
        X : array-like of shape (n_samples, n_inputs)
            Column 0 is the drive.
        y : array-like of shape (n_samples,)
            Measured response.
        ax : matplotlib Axes, array of Axes or None, default=None
            Where to draw; None makes a new figure.
        **plot_options
            Passed to ``plot``.

        Returns
        -------
        display
        """
        dt = interval_of(estimator)
        label = type(estimator).__name__
        return cls.from_predictions(
            X, y, {label: estimator.predict(X)}, dt=dt, ax=ax, **plot_options
        )

    @classmethod
    @documented_like(from_estimator)
    def from_predictions(cls, X, y, y_pred, *, dt=None, ax=None, **plot_options) -> Self:
        """Draw predictions and the measured response.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_inputs)
            Column 0 is the drive; an index carries records and time. Rows that it has lost are
            drawn, interpolated.
        y_pred : array-like of shape (n_samples,), or dict of str to such
            One prediction, or several by name.
        dt : float or None, default=None
            Sampling interval in s, if the index carries no time.

        Raises
        ------
        ValueError
            If a prediction has another length than ``y``.
        """
        response = np.asarray(y, dtype=float).ravel()
        values = np.asarray(X, dtype=float)
        drive = values if values.ndim == 1 else values[:, 0]
        named = y_pred if isinstance(y_pred, dict) else {"model": y_pred}
        predictions = {
            str(name): np.asarray(prediction, dtype=float).ravel()
            for name, prediction in named.items()
        }
        for signal in (drive, *predictions.values()):
            if signal.shape != response.shape:
                raise ValueError(
                    f"The drive and every prediction of {cls.__name__} must be as long as 'y', "
                    f"{response.size} samples. Got {signal.size} samples instead."
                )
        columns = getattr(X, "columns", None)
        records = record_slices(X, y, dt=dt, one_interval=False, bridge=True)
        records, drive, response, *found, _ = with_lost_rows(
            records, drive, response, *predictions.values()
        )
        display = cls(
            drive=drive,
            response=response,
            predictions=dict(zip(predictions, found, strict=True)),
            records=records,
            drive_name="drive" if columns is None else str(columns[0]),
            response_name=str(getattr(y, "name", None) or "response"),
        )
        return display.plot(ax=ax, **plot_options)

    @classmethod
    @documented_like(from_estimator)
    def from_search(cls, search, *, ax=None, draw=True, **plot_options) -> Self:
        """Draw the held-out predictions of a fitted search, before and after.

        Parameters
        ----------
        search : EffectSearchCV
            Fitted.
        draw : bool, default=True
            Whether to draw now, or later with :meth:`plot`.
        """
        predictions = {"declared model": np.asarray(search.prediction_before_, dtype=float)}
        if search.effects_:
            after = "with " + ", ".join(search.effects_)
            predictions[after] = np.asarray(search.prediction_after_, dtype=float)
        drive_name, response_name = signal_names(search)
        display = cls(
            drive=np.asarray(search.drive_, dtype=float),
            response=np.asarray(search.response_, dtype=float),
            predictions=predictions,
            records=tuple(search.records_),
            drive_name=drive_name,
            response_name=response_name,
            noise_floor=float(search.noise_floor_),
        )
        return display.plot(ax=ax, **plot_options) if draw else display

    @property
    def units(self) -> Units:
        """Units of drive, response and time."""
        names = unit_of(self.drive_name), unit_of(self.response_name)
        return Units(*names, self.records[0].time_unit)

    @property
    def spans(self):
        """Row slices of the records."""
        return [record.rows for record in self.records]

    def running_time(self) -> np.ndarray:
        """Return the time of every sample in s: as recorded, or with the records in sequence.

        Recorded times are used if they increase from record to record; otherwise each record
        follows the one before it.
        """
        rising = all(b.start_time > a.time[-1] for a, b in pairwise(self.records))
        time, start = np.empty(len(self.drive)), 0.0
        for record in self.records:
            first = record.start_time if rising else start
            time[record.rows] = first + record.dt * np.arange(record.n_samples)
            start += record.dt * record.n_samples
        return time

    def _draw_in_time(self, ax, values, max_points, label=None, **style):
        """Draw a signal by its outline, which keeps every peak, a line for each record."""
        time = self.running_time()
        for k, span in enumerate(self.spans):
            points = max(8, max_points * (span.stop - span.start) // len(time))
            kept = span.start + envelope(values[span], points // 2)
            shown = plain(label) if label and k == 0 else None
            ax.plot(time[kept], values[kept], label=shown, **style)

    def _mark_records(self, ax):
        """Draw a line at the start of each record but the first."""
        time = self.running_time()
        for span in self.spans[1:]:
            ax.axvline(time[span.start], color=MUTED, linewidth=0.6, linestyle=":")
        ax.margins(x=0.01)

    def _draw_loops(self, ax, values, max_cycles, label=None, **style):
        """Draw a signal against the drive, a line for each stretch of whole cycles.

        Return a title that says which part is drawn, None for all.
        """
        stretches = loop_spans(self.drive, self.spans, max_cycles)
        for k, (rows, cycles) in enumerate(stretches):
            kept = thin_path(self.drive[rows], values[rows], int(_POINTS * max(cycles, 1.0)))
            shown = plain(label) if label and k == 0 else None
            ax.plot(self.drive[rows][kept], values[rows][kept], label=shown, **style)
        if sum(rows.stop - rows.start for rows, _ in stretches) == len(self.drive):
            return None
        number = max(round(sum(cycles for _, cycles in stretches)), 1)
        return f"{number} cycle{'s' * (number > 1)} around the largest excursion"


def signal_names(search):
    """Return the names of drive and response in the data of a search."""
    columns = getattr(search, "feature_names_in_", None)
    drive = "drive" if columns is None else str(columns[0])
    return drive, str(getattr(search, "response_name_", None) or "response")
