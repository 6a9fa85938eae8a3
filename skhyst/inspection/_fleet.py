"""Parameters of many devices over time."""

from typing import Self

import numpy as np
import pandas as pd
from scipy.stats import norm

from .._documentation import documented_like
from ._base import Display
from ._drawing import INK, MUTED, new_axes, plain, tidy

_MOST_LABELS = 24  # that are readable next to each other
_BAR = {"extend": "both", "aspect": 40, "shrink": 0.6}


class FleetDisplay(Display):
    """Parameters of many devices over time: which one changed on which device, and when.

    Make one with :meth:`from_estimator` or :meth:`from_summary`. Each value is compared with the
    first of its device, in standard errors of the difference. Unknown values are hatched.

    Parameters
    ----------
    params, params_std : DataFrame
        Parameters and their standard errors, a column each; the index has two levels, the device
        and when it was measured.

    Attributes
    ----------
    ax_ : ndarray of Axes
        One for each parameter that is drawn.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.inspection import FleetDisplay
    >>> index = pd.MultiIndex.from_product([["stage 1", "stage 2"], [1, 2, 3]])
    >>> params = pd.DataFrame({"gain": [2.0, 2.1, 2.0, 3.0, 3.1, 4.0]}, index)
    >>> display = FleetDisplay(params, 0.1 + 0.0 * params)
    >>> display.moves()[["device", "when", "parameter", "value"]]
        device  when parameter  value
    0  stage 2     3      gain    4.0
    """

    def __init__(self, params, params_std):
        self.params = params
        self.params_std = params_std

    @classmethod
    def from_estimator(cls, estimator, *, ax=None, **plot_options) -> Self:
        """Draw the parameters of a fitted :class:`skhyst.fleet.PerDevice` of two levels.

        Parameters
        ----------
        estimator : PerDevice
            Fitted, with ``level=[device, when]``.
        ax : matplotlib Axes, array of Axes or None, default=None
            Where to draw; None makes a new figure.
        **plot_options
            Passed to ``plot``.

        Returns
        -------
        display

        Raises
        ------
        ValueError
            If the index does not have two levels.
        """
        if estimator.params_.index.nlevels != 2:
            raise ValueError(
                "FleetDisplay.from_estimator needs a PerDevice of two levels, the device and when "
                f"it was measured. Got level={estimator.level!r} instead."
            )
        return cls(estimator.params_, estimator.params_std_).plot(ax=ax, **plot_options)

    @classmethod
    @documented_like(from_estimator)
    def from_summary(cls, table, devices, times, *, ax=None, **plot_options) -> Self:
        """Draw the parameters in a table of :func:`skhyst.fleet.diagnose_files`.

        Parameters
        ----------
        table : DataFrame
            One row per recording.
        devices, times : sequence of length n_rows
            Which device each recording is of, and when it was made.
        """
        index = pd.MultiIndex.from_arrays([list(devices), list(times)], names=["device", "when"])
        frames = [
            table.filter(regex=f"^{kind} ").rename(columns=lambda name: name.partition(" ")[2])
            for kind in ("param", "std")
        ]
        params, params_std = (frame.set_axis(index) for frame in frames)
        return cls(params, params_std).plot(ax=ax, **plot_options)

    def changes(self) -> pd.DataFrame:
        """Return the change of each value since the first of its device, in standard errors.

        Returns
        -------
        DataFrame
            As ``params``, sorted by device and time; NaN if one of the two values, or its error, is
            not known, and 0 for the first.
        """
        params, std = self.params.sort_index(), self.params_std.sort_index()
        std = std.where(np.isfinite(std) & (std > 0.0))
        params = params.where(std.notna())
        first, first_std = (
            frame.groupby(level=0).transform("first") for frame in (params, std)
        )  # "first" skips NaN
        return (params - first) / np.hypot(std, first_std)

    def limit(self, alpha=0.01) -> float:
        """Return the change beyond which a parameter counts as moved.

        Parameters
        ----------
        alpha : float, default=0.01
            Probability of reporting any change although there is none (Bonferroni).

        Returns
        -------
        float
            In standard errors.
        """
        changes = self.changes()
        compared = int((changes.notna() & (changes != 0.0)).to_numpy().sum())
        return float(norm.isf(0.5 * alpha / max(compared, 1)))

    def moves(self, alpha=0.01) -> pd.DataFrame:
        """Return the values that have moved, the largest change first.

        Parameters
        ----------
        alpha : float, default=0.01
            As for :meth:`limit`.

        Returns
        -------
        DataFrame
            Columns ``device``, ``when``, ``parameter``, ``value``, ``change`` (standard errors).
        """
        changes, limit, params = self.changes(), self.limit(alpha), self.params.sort_index()
        rows = [
            (*where, name, float(params[name].iloc[number]), float(value))
            for name in changes
            for number, (where, value) in enumerate(changes[name].items())
            if abs(value) > limit
        ]
        table = pd.DataFrame(rows, columns=["device", "when", "parameter", "value", "change"])
        return table.sort_values("change", key=np.abs, ascending=False, ignore_index=True)

    @documented_like(Display.plot)
    def plot(self, ax=None, *, alpha=0.01, max_parameters=6) -> Self:
        """Draw one panel per parameter: a row for each device, a column for each time.

        Parameters
        ----------
        ax : array of Axes or None, default=None
            As many Axes as parameters are drawn, or one that is divided; None makes a new figure.
        alpha : float, default=0.01
            As for :meth:`limit`; values that have moved are dotted.
        max_parameters : int, default=6
            Parameters to draw, those that changed most first.

        Raises
        ------
        ValueError
            If there is no parameter.
        """
        changes, limit = self.changes(), self.limit(alpha)
        if changes.empty:
            raise ValueError("FleetDisplay has nothing to draw: there is no parameter.")
        names = changes.abs().max().sort_values(ascending=False, kind="stable").index
        names = names[:max_parameters]
        panels = {name: changes[name].unstack() for name in names}
        n_rows, n_columns = next(iter(panels.values())).shape
        size = (2.0 + min(6.0, 1.0 + 0.3 * n_columns), len(names) * (1.0 + min(4.0, 0.25 * n_rows)))
        axes = new_axes(ax, len(names), 1, "FleetDisplay", size=size)[:, 0]
        for panel, (name, table) in zip(axes, panels.items(), strict=True):
            tidy(panel, title=name, y_label=self.params.index.names[0] or "device")
            mesh = panel.pcolormesh(
                table.to_numpy(), cmap="PuOr", vmin=-2.0 * limit, vmax=2.0 * limit
            )
            panel.patch.set(facecolor="white", edgecolor=MUTED, hatch="////")
            panel.grid(False)
            moved = np.argwhere(table.abs().to_numpy() > limit) + 0.5
            dots = {"markersize": 5, "markerfacecolor": "white", "markeredgecolor": INK}
            panel.plot(moved[:, 1], moved[:, 0], "o", **dots)
            _label(panel.xaxis, table.columns if panel is axes[-1] else ())
            _label(panel.yaxis, table.index)
            panel.invert_yaxis()
        axes[-1].set_xlabel(plain(self.params.index.names[1] or "when"))
        bar = axes[0].figure.colorbar(mesh, ax=list(axes), **_BAR)
        bar.set_ticks([-limit, 0.0, limit], labels=[f"{-limit:.1f}", "0", f"+{limit:.1f}"])
        bar.set_label("change (standard errors)", color=INK)
        bar.outline.set_edgecolor(MUTED)
        self.ax_, self.figure_ = axes, axes[0].figure
        return self


def _label(axis, labels):
    """Name as many rows or columns as can be read."""
    shown = range(0, len(labels), 1 + len(labels) // _MOST_LABELS)
    turned = {"rotation": 45, "ha": "right"} if axis.axis_name == "x" else {}
    names = [plain(labels[i], 16) for i in shown]
    axis.set_ticks([i + 0.5 for i in shown], names, fontsize="small", **turned)
    axis.set_tick_params(length=0)
