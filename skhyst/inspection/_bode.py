"""Bode diagrams of measured frequency responses, with models over them."""

from itertools import count
from typing import Self

import numpy as np

from .._documentation import documented_like
from ..linear import FrequencyResponse, frequency_response
from ..records import Units
from ._base import Display, SignalDisplay
from ._drawing import COLORS, FLOOR, INK, MUTED, legend_right, new_axes, plain, tidy
from ._plot_data import log_average

_POINTS = 1000  # of the curve of a model, in addition to the measured lines
_DISTORTION = COLORS[2]
_MODELS = (COLORS[0], COLORS[1], COLORS[3])


class FrequencyResponseDisplay(Display):
    """Bode diagram of a frequency response: magnitude, phase, coherence and confidence bands.

    Make one with :meth:`from_response` or :meth:`from_recording`. All parameters are kept as
    attributes. Each input has a column. The bands contain the true value with the probability
    ``level`` of :meth:`plot`. If the coherence is known it has a row of its own; levels of noise
    (in the averaged response) and of distortion (in a single realisation) are drawn below the
    magnitude, in the same units, as root mean squares over fortieths of a decade.

    Parameters
    ----------
    response : FrequencyResponse
        The measured frequency response.
    models : dict of str to (ndarray of shape (n,), ndarray of shape (n, n_inputs))
        Model name to frequencies in Hz and complex frequency response.

    Attributes
    ----------
    ax_ : ndarray of Axes of shape (2 or 3, n_inputs)
        Axes of the picture: magnitude, phase, and coherence if it is known.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import FrequencyResponseDisplay
    >>> from skhyst.linear import SecondOrderModeOperator
    >>> mode = SecondOrderModeOperator(60.0, 0.05, gain=3.0)
    >>> drive = np.random.default_rng(0).normal(size=5000)
    >>> y, _ = mode.run(drive, 0.01)
    >>> display = FrequencyResponseDisplay.from_recording(drive[:, None], y, mode, dt=0.01)
    >>> display.ax_.shape
    (3, 1)
    """

    def __init__(self, *, response, models):
        self.response = response
        self.models = models

    @classmethod
    @documented_like(SignalDisplay.from_estimator)
    def from_response(cls, response, models=None, *, ax=None, **plot_options) -> Self:
        """Draw a frequency response.

        Parameters
        ----------
        response : FrequencyResponse
            The measured frequency response.
        models : model, list of models, dict of str to model, or None, default=None
            Drawn over it. A model is an object with ``frequency_response(frequency)`` for
            frequencies in Hz, an estimator whose ``operator_`` has that, or another
            :class:`~skhyst.linear.FrequencyResponse`.

        Raises
        ------
        TypeError
            If a model has no frequency response.
        ValueError
            If a model has another number of inputs.
        """
        named = {name: _curve(name, model, response) for name, model in _named(models).items()}
        return cls(response=response, models=named).plot(ax=ax, **plot_options)

    @classmethod
    @documented_like(SignalDisplay.from_estimator)
    def from_recording(cls, X, y, models=None, *, ax=None, **options) -> Self:
        """Estimate the frequency response of a recording and draw it.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_columns)
            The inputs; the index carries records and time.
        y : array-like of shape (n_samples,)
            Response.
        models : model, list of models, dict of str to model, or None, default=None
            Drawn over it, see :meth:`from_response`.
        **options
            Passed to :func:`skhyst.linear.frequency_response`.
        """
        return cls.from_response(frequency_response(X, y, **options), models, ax=ax)

    @documented_like(Display.plot)
    def plot(self, ax=None, *, level=0.95, log_frequency=True) -> Self:
        """Draw it.

        Parameters
        ----------
        ax : array of Axes or None, default=None
            As many as in :attr:`ax_`, or one that is divided; None makes a new figure.
        level : float, default=0.95
            Probability of the bands.
        log_frequency : bool, default=True
            Whether the axis of frequency is logarithmic.
        """
        found = self.response
        n_rows, n_inputs = 2 + (found.coherence is not None), found.n_inputs
        shared = {"size": (1.6 + 4.2 * n_inputs, 2.0 + 1.9 * n_rows), "sharex": True}
        axes = new_axes(ax, n_rows, n_inputs, "FrequencyResponseDisplay", **shared, sharey="row")
        radius = found.confidence_radius(level)
        for i, (magnitude, phase, *rest) in enumerate(axes.T):
            band = None if radius is None else radius[:, i]
            self._plot_magnitude(magnitude, i, band, level)
            self._plot_phase(phase, i, band)
            for panel in rest:
                panel.plot(found.frequency, found.coherence, color=INK, linewidth=0.9)
                panel.set_ylim(0.0, 1.03)
            for panel in (magnitude, phase, *rest):
                panel.set_xscale("log" if log_frequency else "linear")
                tidy(panel)
            titled = n_inputs > 1
            tidy(magnitude, title=f"from {found.input_names[i]}" if titled else None)
            tidy(axes[-1, i], x_label=Units(time=found.time_unit).label("frequency (Hz)"))
        drive = found.input_names[0] if n_inputs == 1 else "input"
        labels = (f"|{found.output_name} / {drive}|", "phase (°)", "coherence")
        for panel, label in zip(axes[:, 0], labels, strict=False):
            tidy(panel, y_label=label)
        legend_right(axes[0, -1], *axes[0, 0].get_legend_handles_labels())
        self.ax_, self.figure_ = axes, axes[0, 0].figure
        return self

    def _curves(self, i):
        """Yield name, frequency, response and colour of each model for one input."""
        for k, (name, (frequency, values)) in enumerate(self.models.items()):
            yield name, frequency, values[:, i], _MODELS[k % len(_MODELS)]

    def _plot_magnitude(self, ax, i, radius, level):
        found = self.response
        frequency, size = found.frequency, np.abs(found.response[:, i])
        label = "measured" if radius is None else f"measured, {100 * level:g} % band"
        ax.plot(frequency, size, color=INK, linewidth=1.1, label=label)
        shown = [size[size > 0]]
        for name, frequency_, values, color in self._curves(i):
            ax.plot(frequency_, np.abs(values), color=color, linewidth=1.1, label=plain(name))
        for name, kind, color in (
            ("distortion_std", "distortion, one realisation", _DISTORTION),
            ("noise_std", "noise of the mean", FLOOR),
        ):
            if getattr(found, name) is not None:
                positive = frequency > 0.0
                at, rms = log_average(frequency[positive], getattr(found, name)[positive, i])
                rms = np.where(rms > 0.0, rms, np.nan)
                ax.plot(at, rms, color=color, linewidth=1.0, label=kind)
                shown.append(rms[np.isfinite(rms)])
        shown = np.concatenate(shown)
        if not shown.size:
            return
        ax.set_yscale("log")
        low, high = 0.5 * shown.min(), 2.0 * shown.max()
        if radius is not None:
            lower = np.maximum(size - radius, 0.1 * low)
            ax.fill_between(frequency, lower, size + radius, color=MUTED, alpha=0.35, lw=0)
        bottom, top = ax.get_ylim() if i else (low, high)  # the columns share their axis
        ax.set_ylim(min(low, bottom), max(high, top))

    def _plot_phase(self, ax, i, radius):
        found = self.response
        frequency, g = found.frequency, found.response[:, i]
        phase = np.angle(g, deg=True)
        if radius is not None:
            ratio = np.divide(radius, np.abs(g), out=np.ones_like(radius), where=g != 0)
            error = np.where(ratio < 1.0, np.rad2deg(np.arcsin(np.minimum(ratio, 1.0))), 180.0)
            for turn in (-360.0, 0.0, 360.0):  # a band that leaves at the top enters at the bottom
                low, high = (np.clip(phase + turn + s * error, -180, 180) for s in (-1, 1))
                ax.vlines(frequency, low, high, color=MUTED, alpha=0.35, linewidth=0.8)
        ax.plot(frequency, phase, ".", color=INK, markersize=2.0)
        for _, frequency_, values, color in self._curves(i):
            ax.plot(frequency_, _broken(np.angle(values, deg=True)), color=color, linewidth=1.1)
        ax.set_ylim(-190.0, 190.0)
        ax.set_yticks(np.arange(-180, 181, 90))


def _broken(phase):
    """Return the phase with NaN before each jump from one end of the circle to the other."""
    jumps = np.flatnonzero(np.abs(np.diff(phase)) > 180.0) + 1
    phase = phase.copy()
    phase[jumps] = np.nan
    return phase


def _named(models):
    """Return the models by their names."""
    if models is None:
        return {}
    if isinstance(models, dict):
        return {str(name): model for name, model in models.items()}
    named = {}
    for model in models if isinstance(models, list | tuple) else [models]:
        name = type(model).__name__
        numbers = (f"{name} {k}" for k in count(2))
        named[name if name not in named else next(n for n in numbers if n not in named)] = model
    return named


def _curve(name, model, response):
    """Return frequencies and frequency response (n, n_inputs) of a model."""
    if isinstance(model, FrequencyResponse):
        frequency, values = model.frequency, model.response
    else:
        own = hasattr(model, "frequency_response")
        source = model if own else getattr(model, "operator_", None)
        if not hasattr(source, "frequency_response"):
            raise TypeError(
                "Every model of FrequencyResponseDisplay must have frequency_response(frequency), "
                f"or a fitted operator_ that has it. Got {name!r}, a {type(model).__name__}, "
                "without it instead."
            )
        frequency = response.frequency[response.frequency > 0.0]
        frequency = np.union1d(frequency, np.geomspace(frequency[0], frequency[-1], _POINTS))
        values = np.asarray(source.frequency_response(frequency), dtype=complex)
    values = values[:, None] if values.ndim == 1 else values
    if values.shape != (frequency.size, response.n_inputs):
        raise ValueError(
            f"Every model of FrequencyResponseDisplay must have {response.n_inputs} input(s). Got "
            f"a response of shape {values.shape} from {name!r} instead."
        )
    return frequency, values
