"""Closed loops of a recording, with the figures of each."""

from typing import Self

import numpy as np

from .._documentation import documented_like
from ..io import unit_of
from ..metrics import (
    FIGURES,
    branches,
    figures_of,
    loop_figures,
    read_loops,
    response_at,
    sections,
    widest_opening,
)
from ._base import Display
from ._drawing import COLORS, INK, legend_right, new_axes, plain, tidy
from ._plot_data import thin_path

_POINTS = 1000  # drawn of a cycle
_UNITS = {"coercivity": "{0}", "area": "{0} {1}"}  # of drive and response; for other figures: {1}


class LoopFiguresDisplay(Display):
    """The closed loops of a recording: coercivity, remanence, area and widest opening.

    Make one with :meth:`from_recording`. A square marks where the response passes its center, a
    circle where the drive does, and a dashed line where the loop is widest.

    Parameters
    ----------
    figures : DataFrame
        As :func:`skhyst.metrics.loop_figures` returns it.
    loops : list of list of (ndarray, ndarray)
        For each of its rows the drive and response of each cycle, first on the rising, then on the
        falling drive: two pairs per cycle.
    center : {"loop", "zero"}, default="loop"
        The origin of coercivity and remanence.
    drive_name, response_name : str, default="drive", "response"
        Names for the axes, with units in brackets.
    time_unit : {"s", "sample"}, default="s"
        Unit of the periods.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import LoopFiguresDisplay
    >>> phase = 2 * np.pi * np.arange(4000) / 1000 - np.pi / 2
    >>> drive, response = 2.0 * np.sin(phase), 5.0 * np.sin(phase - 0.3)
    >>> display = LoopFiguresDisplay.from_recording(drive[:, None], response)
    >>> print(display.lines()[0][:69])
    record 0, 4 cycles from -2 to 2, 999.8 samples each: coercivity 0.591
    """

    def __init__(
        self,
        figures,
        loops,
        *,
        center="loop",
        drive_name="drive",
        response_name="response",
        time_unit="s",
    ):
        self.figures = figures
        self.loops = loops
        self.center = center
        self.drive_name = drive_name
        self.response_name = response_name
        self.time_unit = time_unit

    @classmethod
    @documented_like(loop_figures)
    def from_recording(
        cls,
        X,
        y,
        *,
        center="loop",
        tolerance=0.05,
        skip=0,
        dt=None,
        ax=None,
        draw=True,
        **plot_options,
    ) -> Self:
        """Draw the loops of a recording.

        Parameters
        ----------
        ax : matplotlib Axes or None, default=None
            Where to draw; None makes a new figure.
        draw : bool, default=True
            Whether to draw now, or later with :meth:`plot`.
        **plot_options
            Passed to :meth:`plot`.

        Returns
        -------
        display
        """
        options = {"center": center, "tolerance": tolerance, "skip": skip, "dt": dt}
        u, response, found = read_loops(X, y, **options)
        columns = getattr(X, "columns", None)
        display = cls(
            figures_of(u, response, found, center),
            [[branches(u, response, cycle) for cycle in loop.rows] for loop in found],
            center=center,
            drive_name="drive" if columns is None else str(columns[0]),
            response_name=str(getattr(y, "name", None) or "response"),
            time_unit=found[0].time_unit,
        )
        return display.plot(ax=ax, **plot_options) if draw else display

    def lines(self, most=None) -> list[str]:
        """Return a sentence on each loop, with units and standard errors.

        Parameters
        ----------
        most : int, default=None
            Number of loops described, those with the most cycles; by default all.

        Returns
        -------
        list of str
        """
        units = unit_of(self.drive_name), unit_of(self.response_name)
        time = "s" if self.time_unit == "s" else "samples"
        found, numbered = [], self.figures["n_cycles"].reset_index(drop=True)
        chosen = numbered.nlargest(len(numbered) if most is None else most).index.sort_values()
        for (record, _), row in self.figures.iloc[chosen].iterrows():
            if not row["n_cycles"]:
                found.append(f"record {record}: no closed loop")
                continue
            numbers = []
            for name in FIGURES:
                unit = _UNITS.get(name, "{1}").format(*units).strip()
                std = row[f"{name}_std"]
                error = f" ± {std:.2g}" if np.isfinite(std) else ""
                numbers.append(f"{name} {row[name]:.3g}{error} {unit}".strip())
            ends = f"from {row['low']:.4g} to {row['high']:.4g} {units[0]}".strip()
            count = f"{row['n_cycles']:.0f} cycle{'s' if row['n_cycles'] > 1 else ''}"
            head = f"record {record}, {count} {ends}, {row['period']:.4g} {time} each"
            found.append(f"{head}: {', '.join(numbers)}")
        if len(chosen) < len(numbered):
            found.append(f"and {len(numbered) - len(chosen)} more with fewer cycles")
        return found

    def plot(self, ax=None, *, max_loops=4) -> Self:
        """Draw the loops.

        Parameters
        ----------
        ax : matplotlib Axes or None, default=None
            Where to draw; None makes a new figure.
        max_loops : int, default=4
            Loops to draw, those with the most cycles.
        """
        ((panel,),) = new_axes(ax, 1, 1, "LoopFiguresDisplay", size=(7.0, 4.4))
        shown = np.argsort(-self.figures["n_cycles"].to_numpy(), kind="stable")[:max_loops]
        for k, number in enumerate(sorted(n for n in shown if self.loops[n])):
            row, pairs = self.figures.iloc[number], self.loops[number]
            color = COLORS[k % len(COLORS)]
            record = f"{self.figures.index[number][0]}: "
            label = record + f"{row['low']:.3g} to {row['high']:.3g}, area {row['area']:.3g}"
            if np.isfinite(row["area_std"]):
                label += f" ± {row['area_std']:.1g}"
            for branch in (own for pair in pairs for own in pair):
                kept = thin_path(*branch, _POINTS)
                panel.plot(branch[0][kept], branch[1][kept], color=color, linewidth=0.8)
            panel.plot([], [], color=color, label=plain(label))
            self._mark(panel, pairs, color)
        if not any(self.loops):
            panel.text(0.5, 0.5, "no closed loop", ha="center", transform=panel.transAxes)
        else:
            legend_right(panel)
        tidy(panel, x_label=self.drive_name, y_label=self.response_name)
        self.ax_, self.figure_ = panel, panel.figure
        return self

    def _mark(self, panel, pairs, color):
        """Mark where the loop passes its center, and where it is widest."""
        drive, response, *cuts = (
            np.mean(own, axis=0)
            for own in zip(*(sections(p, self.center) for p in pairs), strict=True)
        )
        style = {"color": color, "markeredgecolor": INK, "linestyle": "none"}
        style |= {"markersize": 5.0, "zorder": 3}
        panel.plot(cuts[0], [response, response], marker="s", **style)
        panel.plot([drive, drive], cuts[1], marker="o", **style)
        level, _ = widest_opening(pairs)
        sides = [np.mean([response_at(level, pair[i]) for pair in pairs]) for i in (0, 1)]
        panel.plot([level, level], sides, color=INK, linestyle="--", linewidth=1.0, zorder=2)
