"""Poles and zeros of linear models in the plane of s."""

from typing import Self

import numpy as np
from scipy.stats import chi2
from sklearn.utils.validation import check_is_fitted

from .._documentation import documented_like
from ..records import Units
from ._base import Display, SignalDisplay
from ._drawing import COLORS, INK, MUTED, new_axes, plain, tidy

_DAMPING = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7)
_APART = 0.08  # of the width, distance of rays of constant damping
_FRAME = 0.12  # of the range, margin around the poles
_WIDE = 15.0  # ratio of the largest real part to the median above which the axis is logarithmic


class PoleZeroDisplay(Display):
    """Poles and zeros of one linear model or several, with confidence ellipses.

    Make one with :meth:`from_estimator`. All parameters are kept as attributes. A cross is a pole,
    a ring a zero; only the upper half plane is drawn, the lower one mirrors it. Dotted rays have
    one damping ratio each. The axes are in Hz and scaled independently, since the modes of a light
    structure are close to the imaginary axis; if other poles or zeros are far from it, the real
    axis is logarithmic on both sides, and linear only near zero.

    Parameters
    ----------
    poles : dict of str to ndarray, complex
        Model name to poles, rad/s.
    zeros : dict of str to ndarray, complex
        Model name to zeros, rad/s; for all inputs together.
    covariances : dict of str to ndarray of shape (n_poles, 2, 2) or None
        Of real and imaginary part of each pole, (rad/s)^2.
    time_unit : {"s", "sample"}, default="s"
        "sample" if the models were fitted to data without a time.

    Examples
    --------
    >>> from scipy.signal import lti
    >>> from skhyst.inspection import PoleZeroDisplay
    >>> from skhyst.linear import TransferFunction
    >>> model = TransferFunction.from_system(lti([1.0], [1.0, 2.0, 100.0]), dt=0.01)
    >>> display = PoleZeroDisplay.from_estimator(model)
    >>> display.ax_.get_xlabel()
    'real part / 2π (Hz)'
    """

    def __init__(self, poles, zeros, covariances, time_unit="s"):
        self.poles = poles
        self.zeros = zeros
        self.covariances = covariances
        self.time_unit = time_unit

    @classmethod
    @documented_like(SignalDisplay.from_estimator)
    def from_estimator(cls, estimator, *, ax=None, **plot_options) -> Self:
        """Draw the poles and zeros of fitted linear models.

        Parameters
        ----------
        estimator : TransferFunction, ModalModel, or dict of str to such
            Fitted; one, or several by name.

        Raises
        ------
        TypeError
            If an estimator has no poles.
        """
        named = estimator if isinstance(estimator, dict) else {type(estimator).__name__: estimator}
        poles, zeros, covariances, time_unit = {}, {}, {}, "s"
        for name, model in named.items():
            check_is_fitted(model)
            if not hasattr(model, "poles_"):
                raise TypeError(
                    "PoleZeroDisplay needs models with poles, TransferFunction or ModalModel. Got "
                    f"{type(model).__name__} instead."
                )
            poles[name] = np.asarray(model.poles_)
            own = getattr(model, "zeros_", np.empty(0))
            zeros[name] = np.concatenate(own) if isinstance(own, list) else np.asarray(own)
            covariances[name] = model.poles_covariance_
            for record in getattr(model, "records_", ()):
                time_unit = record.time_unit
        return cls(poles, zeros, covariances, time_unit).plot(ax=ax, **plot_options)

    @documented_like(Display.plot)
    def plot(self, ax=None, *, level=0.95, max_frequency=None, real_scale="auto") -> Self:
        """Draw the poles and zeros.

        Parameters
        ----------
        level : float, default=0.95
            Probability that an ellipse contains its pole.
        max_frequency : float or None, default=None
            Largest natural frequency in Hz that is shown; None shows all poles, and the zeros up
            to twice the fastest pole.
        real_scale : {"auto", "linear", "symlog"}, default="auto"
            Scale of the real axis.
        """
        axes = new_axes(ax, 1, 1, "PoleZeroDisplay", size=(7.4, 5.0))[0, 0]
        hertz, seen = 2.0 * np.pi, []
        fastest = max(np.abs(poles).max() for poles in self.poles.values()) / hertz
        reach = fastest if max_frequency is None else max_frequency
        beyond = 2.0 * reach if max_frequency is None else reach
        for k, (name, poles) in enumerate(self.poles.items()):
            color = COLORS[k % len(COLORS)]
            shown = (poles.imag >= 0.0) & (np.abs(poles) <= 1.0001 * reach * hertz)
            p = poles[shown] / hertz
            zeros = self.zeros[name]
            z = zeros[(zeros.imag >= 0.0) & (np.abs(zeros) <= beyond * hertz)] / hertz
            cross = {"markersize": 8, "markeredgewidth": 1.8, "zorder": 4, "label": plain(name)}
            ring = {"markersize": 7, "markerfacecolor": "none", "zorder": 3}
            axes.plot(p.real, p.imag, "x", color=color, clip_on=False, **cross)
            axes.plot(z.real, z.imag, "o", color=color, clip_on=False, **ring)
            covariance = self.covariances[name]
            if covariance is not None:
                self._draw_ellipses(axes, p, covariance[shown] / hertz**2, level, color)
            seen += [*p, *z]
        self._frame(axes, np.array(seen, dtype=complex), real_scale)
        self._draw_damping(axes)
        parts = ("real part / 2π (Hz)", "imaginary part / 2π (Hz)")
        x_label, y_label = map(Units(time=self.time_unit).label, parts)
        tidy(axes, x_label=x_label, y_label=y_label)
        axes.plot([], [], "x", color=MUTED, label="poles")
        axes.plot([], [], "o", color=MUTED, markerfacecolor="none", label="zeros")
        where = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if ax is None else {}
        axes.legend(fontsize="small", framealpha=0.8, **where)
        self.ax_, self.figure_ = axes, axes.figure
        return self

    @staticmethod
    def _draw_ellipses(axes, poles, covariances, level, color):
        angle = np.linspace(0.0, 2.0 * np.pi, 181)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        for pole, covariance in zip(poles, covariances, strict=True):
            if not np.isfinite(covariance).all():
                continue
            # a real pole moves along the axis only
            radius = np.sqrt(chi2.ppf(level, 2 if pole.imag > 0.0 else 1))
            values, vectors = np.linalg.eigh(covariance)
            edge = radius * (vectors * np.sqrt(np.maximum(values, 0.0))) @ circle
            axes.plot(pole.real + edge[0], pole.imag + edge[1], color=color, linewidth=1.0)

    @staticmethod
    def _frame(axes, points, real_scale):
        """Choose the scale of the real axis and the limits of both."""
        if real_scale not in ("auto", "linear", "symlog"):
            raise ValueError(
                "The 'real_scale' parameter of PoleZeroDisplay must be 'auto', 'linear' or "
                f"'symlog'. Got {real_scale!r} instead."
            )
        size = np.abs(points.real)
        size = np.sort(size[size > 0.0])
        if not len(size):
            size = np.array([np.abs(points).max(initial=1.0)])
        wide = size[-1] > _WIDE * np.median(size)
        left, right = min(points.real.min(initial=0.0), 0.0), max(points.real.max(initial=0.0), 0.0)
        top = points.imag.max(initial=0.0) or size[-1]
        if real_scale == "symlog" or (real_scale == "auto" and wide):
            near = 10.0 ** np.floor(np.log10(size[len(size) // 10]))  # ticks on whole decades
            axes.set_xscale("symlog", linthresh=near, linscale=0.6)
            axes.set_xlim(2.0 * min(left, -size[0]), 2.0 * max(right, near))
        else:
            margin = _FRAME * (right - left)
            axes.set_xlim(left - margin, right + margin)
        axes.set_ylim(-0.5 * _FRAME * top, (1.0 + _FRAME) * top)
        axes.axvline(0.0, color=INK, linewidth=0.9, zorder=1)
        axes.axhline(0.0, color=INK, linewidth=0.9, zorder=1)

    @staticmethod
    def _draw_damping(axes):
        """Draw rays of constant damping ratio that leave the picture at its upper edge."""
        top, (left, right) = axes.get_ylim()[1], axes.get_xlim()
        place = axes.transData.transform
        height, width = np.linspace(0.0, top, 200), abs(place((right, 0))[0] - place((left, 0))[0])
        last = place((0.0, 0.0))[0]
        for zeta in _DAMPING:
            rate = zeta / np.sqrt(1.0 - zeta**2)
            at = place((-rate * top, top))[0]
            if -rate * top < left or last - at < _APART * width:
                continue
            last = at
            axes.plot(-rate * height, height, ":", color=MUTED, linewidth=0.9, zorder=1)
            style = {"fontsize": "x-small", "color": MUTED, "ha": "center"}
            above = {"xytext": (0, 2), "textcoords": "offset points"}
            axes.annotate(f"ζ {zeta:g}", (-rate * top, top), **above, **style)
