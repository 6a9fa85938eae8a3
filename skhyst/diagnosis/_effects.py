"""The effects: named physical mechanisms, each a model plus the place where it enters."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..disturbance import Drift, Offset, PeriodicDisturbance
from ..linear import Delay, FirstOrderLag, KelvinVoigt, SecondOrderMode, TransferFunction
from ..static import DeadZones, Saturation, SmoothCurve

__all__ = ["EFFECTS", "Effect", "effect_names", "register_effect", "unregister_effect"]


@dataclass(frozen=True)
class Effect:
    """A named physical effect.

    Parameters
    ----------
    name : str
        Its name in reports and in the steps of the augmented model.
    variants : callable
        Returns a list of unfitted models, simplest first; the data choose among them.
    law : str
        One sentence of physics.
    experiment : str
        The measurement that shows it best and tells it apart from others.
    beside : bool, default=False
        It is added to the response; otherwise it is a step of the series, where its operator's
        ``rank`` says, which a model of your own repeats as ``_rank``.
    plausible : callable, optional
        Tells from the identified operator whether it still is what the name says.
    """

    name: str
    variants: Callable
    law: str
    experiment: str
    beside: bool = False
    plausible: Callable | None = None


def _rings(operator):
    """Tell whether a mode has a peak: above this damping ratio there is none."""
    damping = getattr(operator, "damping_ratios", getattr(operator, "damping_ratio", None))
    return bool(np.min(damping) < np.sqrt(0.5))


def _sides(model, **options):
    return lambda: [model(sides=sides, **options) for sides in ("upper", "lower", "both")]


_BUILT_IN = (
    Effect(
        "input_saturation",
        _sides(Saturation, rank="drive"),
        "The drive is clipped before it reaches the actuator.",
        "Drive beyond the suspected level in both directions: the loop then repeats unchanged.",
    ),
    Effect(
        "delay",
        lambda: [Delay()],
        "The response follows the drive after a pure shift in time.",
        "Sweep faster: the phase of a delay grows in proportion to frequency, the gain stays.",
    ),
    Effect(
        "asymmetry",
        lambda: [
            DeadZones(n, sides=sides) for n in (1, 2, 3) for sides in ("upper", "lower", "both")
        ],
        "One-sided dead zones behind the hysteresis make its two branches curve differently.",
        "Sweep faster: dynamics behind the hysteresis separate a curve at the hysteresis from "
        "one at the sensor.",
    ),
    Effect(
        "lag",
        lambda: [FirstOrderLag()],
        "A first-order low-pass delays and attenuates fast motion.",
        "Sweep to higher frequency: gain and phase fall together.",
    ),
    Effect(
        "resonance",
        lambda: [SecondOrderMode(), TransferFunction(n_poles=2, n_zeros=2)],
        "A second-order mode stores and returns energy.",
        "Apply a step or a sweep through the frequency and watch it ring.",
        plausible=_rings,
    ),
    Effect(
        "creep",
        lambda: [KelvinVoigt(n) for n in (1, 2, 3)],
        "The response goes on relaxing after each change of the drive, over decades of time.",
        "Step and rest: hold the drive for much longer than the slowest motion seen so far.",
    ),
    Effect(
        "static_nonlinearity",
        lambda: [SmoothCurve(degree) for degree in (2, 3, 5, 7, 9)],
        "The reading is a smooth memoryless curve of the response, as of a nonlinear sensor.",
        "Calibrate the sensor on its own, or sweep faster: a curve at the sensor acts behind the "
        "dynamics.",
    ),
    Effect(
        "output_saturation",
        _sides(Saturation, rank="sensor"),
        "The reading is clipped at a level.",
        "Shift the working point by a known amount: the level stays with the reading.",
    ),
    Effect(
        "offset",
        lambda: [Offset()],
        "Each record has a constant of its own.",
        "Repeat a record after setting up the sensor anew.",
        beside=True,
    ),
    Effect(
        "drift",
        lambda: [Drift(degree) for degree in (1, 3, 8)],
        "The response moves slowly with time, whatever the drive does.",
        "Rest at a constant drive for as long as a record takes.",
        beside=True,
    ),
    Effect(
        "periodic_disturbance",
        lambda: [PeriodicDisturbance(n) for n in (1, 2, 3)],
        "Sinusoids at frequencies of their own are added to the response.",
        "Record at rest: the lines remain when the drive does not move.",
        beside=True,
    ),
)

EFFECTS = {effect.name: effect for effect in _BUILT_IN}


def register_effect(effect):
    """Make an effect of your own known to every later search under its name.

    Parameters
    ----------
    effect : Effect
        Its models are parametric models of skhyst, or of your own.

    Raises
    ------
    ValueError
        If the name is taken.

    Examples
    --------
    >>> from skhyst.diagnosis import Effect, register_effect
    >>> from skhyst.linear import TransferFunction
    >>> register_effect(
    ...     Effect(
    ...         name="third_order_dynamics",
    ...         variants=lambda: [TransferFunction(n_poles=3)],
    ...         law="A mode behind a low-pass.",
    ...         experiment="Sweep further.",
    ...     )
    ... )
    >>> from skhyst.diagnosis import effect_names
    >>> "third_order_dynamics" in effect_names()
    True
    >>> from skhyst.diagnosis import unregister_effect
    >>> unregister_effect("third_order_dynamics")
    """
    if effect.name in EFFECTS:
        raise ValueError(f"An effect named '{effect.name}' is registered already.")
    EFFECTS[effect.name] = effect


def unregister_effect(name):
    """Forget an effect that was registered."""
    if name not in EFFECTS:
        raise ValueError(f"No effect is named '{name}'. There are: {', '.join(EFFECTS)}.")
    del EFFECTS[name]


def effect_names():
    """Return the names of all effects that a search tries."""
    return list(EFFECTS)
