"""What a claim rests on: a number and a picture."""

from dataclasses import dataclass

__all__ = ["Evidence", "Picture", "gather_evidence"]


@dataclass(frozen=True)
class Picture:
    """Curves to draw: each is (label, x, y, style), style "line", "points" or "dashed"."""

    title: str
    x_label: str
    y_label: str
    curves: tuple
    x_log: bool = False
    y_log: bool = False


@dataclass(frozen=True)
class Evidence:
    """What a claim rests on.

    ``numbers`` maps a name to (value, standard error or NaN, unit).
    """

    effect: str
    statement: str
    numbers: dict
    picture: Picture


def gather_evidence(effect, structure, result, records, before, after):
    """Return the evidence for a claimed effect of a fitted structure."""
    return Evidence(effect, "", {}, Picture("", "", "", ()))
