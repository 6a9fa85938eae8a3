"""Common to all pictures: the import of matplotlib, colours, axes.

The colours are distinguishable with any form of colour blindness and visible on white and on black
paper (after Okabe and Ito, *Color Universal Design*, 2008, slightly lightened).
"""

import importlib
import textwrap
from functools import partial

import numpy as np

INK = "#24292f"
MUTED = "#868e96"
MEASURED = "#9aa1a9"
FLOOR = "#1f9e77"
COLORS = ("#d55e00", "#2a85c4", "#b5679f", "#a88400")
_LONGEST = 18  # characters of a line of a legend next to the data
_NARROW = 5.0  # inches, below which such a legend takes a third of the figure


def import_matplotlib(module, caller):
    """Import a module below ``matplotlib``, or say how to install it."""
    try:
        return importlib.import_module(f"matplotlib.{module}")
    except ImportError as error:
        raise ImportError(
            f"{caller} needs matplotlib, which is not installed. "
            'Install it with: python -m pip install "skhyst[plot]"'
        ) from error


def new_axes(ax, n_rows, n_columns, caller, *, size, **options):
    """Return an object array of axes, shape (n_rows, n_columns), made where none were given.

    One given Axes is divided where more are needed; ``size`` is that of a new figure in inches,
    ``options`` are ``sharex`` and ``sharey`` of new axes.
    """
    n_panels = n_rows * n_columns
    if ax is None:
        pyplot = import_matplotlib("pyplot", caller)
        figure = pyplot.figure(figsize=size, layout="constrained")
        return figure.subplots(n_rows, n_columns, squeeze=False, **options)
    given = np.asarray(ax, dtype=object)
    if given.size == n_panels:
        return given.reshape(n_rows, n_columns)
    if given.size != 1:
        raise ValueError(
            f"The 'ax' parameter of {caller} must be None, one Axes or {n_panels} Axes. "
            f"Got {given.size} Axes instead."
        )
    host = given.ravel()[0]
    host.set_axis_off()
    return host.get_subplotspec().subgridspec(n_rows, n_columns).subplots(squeeze=False, **options)


def plain(text, width=48):
    """Return text that matplotlib draws literally: no formula, at most one line."""
    text = " ".join(str(text).split())
    text = text if len(text) <= width else text[: width - 1] + "…"
    return text.replace("$", r"\$")


def legend_right(ax, handles=None, labels=None):
    """Put the legend to the right of the data if the layout of the figure makes room for it.

    A narrow figure has one legend for all axes, below them.
    """
    if handles is None:
        handles, labels = ax.get_legend_handles_labels()
    figure, style = ax.figure, {"handlelength": 1.4}
    if figure.get_layout_engine() is None:
        ax.legend(handles, labels, loc="best", framealpha=0.7, **style)
        return
    if figure.get_figwidth() < _NARROW:
        for other in list(figure.legends):
            handles = [*other.legend_handles, *handles]
            labels = [*(text.get_text() for text in other.get_texts()), *labels]
            other.remove()
        shown = dict(zip(labels, handles, strict=True))
        em = import_matplotlib("font_manager", "A legend").FontProperties().get_size() / 72.0
        entry = (4.0 + 0.55 * max(map(len, shown), default=0)) * em  # handle, gaps, mean letters
        columns = max(int(figure.get_figwidth() / entry), 1)
        style |= {"loc": "outside lower left", "ncols": columns, "frameon": False}
        figure.legend(list(shown.values()), list(shown), **style)
        return
    labels = [textwrap.fill(label, _LONGEST) for label in labels]
    placement = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
    ax.legend(handles, labels, **placement, **style)


def _plain_numbers():
    """Return a formatter of ticks: only the power of ten they share is a formula.

    To draw a formula takes a hundred times as long as to draw text.
    """
    ticker = import_matplotlib("ticker", "A picture")

    class PlainNumbers(ticker.ScalarFormatter):
        def __call__(self, x, pos=None):
            return super().__call__(x, pos).removeprefix(r"$\mathdefault{").removesuffix("}$")

    formatter = PlainNumbers(useMathText=True)
    formatter.set_powerlimits((-3, 5))
    return formatter


def _between_decades(axis, value, position=None):
    """Return the label of a tick between decades: 2 and 5 of each, where few decades are shown."""
    low, high = sorted(axis.get_view_interval())
    return f"{value:g}" if high < 100.0 * low and f"{value:e}"[0] in "25" else ""


def tidy(ax, *, title=None, x_label=None, y_label=None):
    """Give the axes a quiet frame, a faint grid and labels."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, color=MUTED, alpha=0.22, linewidth=0.6)
    ax.set_axisbelow(True)
    for axis in (ax.xaxis, ax.yaxis):
        if axis.get_scale() == "linear":
            axis.set_major_formatter(_plain_numbers())
        elif axis.get_scale() == "log":
            axis.set_minor_formatter(partial(_between_decades, axis))
    ax.xaxis.get_offset_text().set(x=1.01, horizontalalignment="left")  # clear of the label
    if title is not None:
        ax.set_title(plain(title), loc="left", fontsize="medium", fontweight="bold")
    if x_label is not None:
        ax.set_xlabel(plain(x_label))
    if y_label is not None:
        ax.set_ylabel(plain(y_label))
