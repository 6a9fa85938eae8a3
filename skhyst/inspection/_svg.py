"""Pictures as SVG elements embedded in a page."""

import html
import io
import json
import re
import warnings

from .._files import printable
from ._drawing import INK, import_matplotlib

_PAPER = "#fdfdfe"


def svg_text(draw, size, label) -> str:
    """Draw, and return the SVG element for a page, without identifiers of its own.

    Foreground, background and font are those of the page (the CSS variables ``--ink``, ``--paper``
    and ``--sans``), so that a picture is readable on a dark page too.

    Parameters
    ----------
    draw : callable
        Called with an empty matplotlib Figure.
    size : tuple of float
        Width and height, inches.
    label : str
        Description of the picture, for screen readers.

    Returns
    -------
    str

    Raises
    ------
    ImportError
        Where matplotlib is not installed.

    Examples
    --------
    >>> from skhyst.inspection import svg_text
    >>> text = svg_text(lambda figure: figure.subplots().plot([0, 1]), (4.0, 3.0), "A line")
    >>> text[:4], 'aria-label="A line"' in text
    ('<svg', True)
    """
    matplotlib = import_matplotlib("pyplot", "The pictures of a report")
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    inked = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
    style = dict.fromkeys(inked, INK) | {
        "svg.fonttype": "none",
        "svg.hashsalt": label,
        "font.size": 9.0,
        "axes.facecolor": _PAPER,
        "legend.facecolor": _PAPER,
        "legend.edgecolor": "none",
        "axes.unicode_minus": True,
    }
    with matplotlib.rc_context(style), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        for written in figure.findobj(Text):  # matplotlib cannot measure half of a surrogate pair
            written.set_text(printable(written.get_text()))
        text = io.StringIO()
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        for number, ax in enumerate(figure.axes):
            ax.set_gid(f"axes of the page {number}")
        figure.savefig(text, format="svg", facecolor="none", metadata=nothing)
        axes = [_where(ax, figure) for ax in figure.axes]
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    for number, own in enumerate(axes):
        svg = svg.replace(f'<g id="axes of the page {number}"', f'<g data-axes="{own}"', 1)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    opening = (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="0 0 {72.0 * size[0]:g} {72.0 * size[1]:g}" role="img" '
        f'aria-label="{html.escape(printable(label))}">'
    )
    svg = opening + svg[svg.index(">") + 1 :]
    svg = re.sub(r"(font:[^;\"]*?)'DejaVu Sans'[^;\"]*", r"\1var(--sans)", svg)
    return svg.replace(INK, "var(--ink)").replace(_PAPER, "var(--paper)")


def _where(ax, figure):
    """Return position, limits, names and scales of axes, as an attribute for a page's script."""
    width, height = figure.get_size_inches() * 72.0
    x, y, across, up = ax.get_position().bounds
    place = [x * width, (1.0 - y - up) * height, across * width, up * height]
    limits = [*ax.get_xlim(), *ax.get_ylim()]
    names = [re.sub(r"\\(.)", r"\1", name) for name in (ax.get_xlabel(), ax.get_ylabel())]
    logs = [ax.get_xscale() == "log", ax.get_yscale() == "log"]
    numbers = [float(f"{value:.7g}") for value in place + limits]
    return html.escape(json.dumps([*numbers, *names, *logs]))
