"""The picture that supports one claim."""

from itertools import cycle
from typing import Self

import numpy as np

from .._documentation import documented_like
from ._base import Display, SignalDisplay
from ._drawing import COLORS, FLOOR, MEASURED, legend_right, new_axes, plain, tidy
from ._plot_data import thin_path

_FEW = 100  # points that are drawn large, on top of the lines


class EvidenceDisplay(Display):
    """The picture that belongs to a claimed effect.

    Parameters
    ----------
    picture : Picture
        Title, axes and curves, from an ``Evidence`` of :class:`skhyst.diagnosis.EffectSearchCV`.

    Attributes
    ----------
    ax_ : matplotlib Axes or ndarray of Axes of shape (2,)
        Two if there is a second picture underneath, such as the phase below the gain.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from skhyst.inspection import EvidenceDisplay
    >>> curve = ("residual", [1.0, 2.0, 4.0], [0.3, 0.2, 0.1], "line")
    >>> picture = SimpleNamespace(title="Creep", x_label="time (s)", y_label="residual",
    ...                           x_log=True, y_log=False, curves=(curve,))
    >>> EvidenceDisplay(picture).plot().ax_.get_xscale()
    'log'
    """

    def __init__(self, picture):
        self.picture = picture

    @classmethod
    @documented_like(SignalDisplay.from_search)
    def from_search(cls, search, effect, *, ax=None, draw=True, **plot_options) -> Self:
        """Draw the evidence for an effect that a search has claimed.

        Parameters
        ----------
        effect : str
            One of ``search.effects_``.

        Raises
        ------
        ValueError
            If the search did not claim the effect.
        """
        if effect not in search.evidence_:
            raise ValueError(
                f"The 'effect' parameter of EvidenceDisplay.from_search must be one of "
                f"{list(search.evidence_)}. Got {effect!r} instead."
            )
        display = cls(search.evidence_[effect].picture)
        return display.plot(ax=ax, **plot_options) if draw else display

    @documented_like(Display.plot)
    def plot(self, ax=None, *, max_points=2000) -> Self:
        """Draw the picture.

        Parameters
        ----------
        max_points : int, default=2000
            Points to draw for each curve; a longer one is drawn by its outline.
        """
        below = getattr(self.picture, "below", None)
        pictures = [self.picture] if below is None else [self.picture, below]
        size = (6.0, 4.0 if below is None else 5.6)
        axes = new_axes(ax, len(pictures), 1, "EvidenceDisplay", size=size)[:, 0]
        for panel, picture in zip(axes, pictures, strict=True):
            self._draw(panel, picture, max_points)
        if any(str(label) for label, *_ in self.picture.curves):
            legend_right(axes[0])
        self.ax_ = axes[0] if below is None else axes
        self.figure_ = axes[0].figure
        return self

    @staticmethod
    def _draw(axes, picture, max_points):
        styles = [style for *_, style in picture.curves]
        pairs = styles.count("points") > 1
        # points and the line that is to match them have one colour
        points = cycle(COLORS if pairs else (MEASURED,))
        lines = cycle(COLORS if pairs else (COLORS[1], COLORS[2], COLORS[3], FLOOR))
        dashes = cycle((FLOOR,))
        for label, x, y, style in picture.curves:
            x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
            kept = thin_path(x, y, max_points)
            color = next({"points": points, "line": lines}.get(style, dashes))
            options = {"color": color, "label": plain(label)}
            if style == "points":
                few = len(x) <= _FEW
                size = {"markersize": 4.2, "zorder": 3} if few else {"markersize": 2.6}
                axes.plot(x[kept], y[kept], "o", alpha=0.75, mew=0, **size, **options)
            else:
                line = "--" if style == "dashed" else "-"
                axes.plot(x[kept], y[kept], line, linewidth=1.4, **options)
        if getattr(picture, "surface", None) is not None:
            x, y, values, density = picture.surface
            shades = np.nan_to_num(density) / np.nanmax(density)
            axes.pcolormesh(x, y, shades, cmap="Greys", vmax=2.0, shading="nearest")
            lines = axes.contour(x, y, np.ma.masked_invalid(values), levels=9, linewidths=1.2)
            axes.clabel(lines, fontsize="medium")
        axes.set_xscale("log" if picture.x_log else "linear")
        axes.set_yscale("log" if picture.y_log else "linear")
        tidy(axes, title=picture.title, x_label=picture.x_label, y_label=picture.y_label)
