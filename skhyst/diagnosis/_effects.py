"""The effects: named physical mechanisms, each a model plus the place where it enters."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import partial

import numpy as np

from ..disturbance import Drift, Offset, PeriodicDisturbance
from ..hysteresis import (
    Backlash,
    BoucWen,
    BoucWenStage,
    CoulombFriction,
    Dahl,
    EndStops,
    FreeMass,
    FrictionStage,
    MaxwellSlip,
    PrandtlIshlinskii,
    RestoringForce,
    SlewLimit,
)
from ..linear import (
    Delay,
    FirstOrderLag,
    Gain,
    KelvinVoigt,
    SecondOrderMode,
    TimeShift,
    TransferFunction,
)
from ..static import (
    DeadBand,
    DeadZones,
    Fold,
    Saturation,
    SmoothCurve,
    SoftSaturation,
)
from ._changes import (
    AtJoints,
    BehindHysteresis,
    BesideHysteresis,
    Driven,
    FirstHysteresis,
    Folded,
    FollowedWidth,
    HeldDrive,
    InBetween,
    InFeedback,
    InMotion,
    InStages,
    Knee,
    LoadedForce,
    LoadedMotion,
    MoreTerms,
    MovedModes,
    ParallelForce,
    PerRecord,
    RateDependence,
    Scaling,
    UnderWay,
)
from ._plausibility import (
    bends,
    bends_to_one_side,
    builds_up,
    delay_beyond_sampling,
    has_no_peak,
    has_own_lines,
    input_beyond_dead_zone,
    is_between_samples,
    levels_off,
    responds_promptly,
    rings,
    slides,
    stops,
    varies_in_rate,
    width_beyond_noise,
)


@dataclass(frozen=True)
class Effect:
    """A named physical effect.

    Parameters
    ----------
    name : str
        Name in reports and in the steps of the augmented model.
    variants : callable
        Returns a list of unfitted models, simplest first; the data choose among them. A change
        other than a new stage is an object with ``trees(name, scene)``.
    law : str
        The physical law in one sentence.
    experiment : str
        The measurement that shows the effect best and distinguishes it from others.
    additive : bool, default=False
        Whether it is an additive disturbance; otherwise it is a step of the series, placed by the
        ``stage_order`` of its operator.
    picture : str, optional
        Which picture shows the evidence: the contribution of a part against its input, as a
        ``"curve"`` or along a ``"loop"``; a force against ``"displacement"`` or ``"velocity"``;
        ``"frequency"``, gain and phase; ``"relaxation"`` after a step; a disturbance over
        ``"time"``, or its ``"spectrum"``; the contribution of the ``"rate"`` of the drive. By
        default a curve, and for an additive disturbance its course over time.
    plausible : callable, optional
        Returns a margin above zero where the identified part has the property that the name states.
        It is called with the operator, the samples of its output, or of its input where several
        forces add up (none for an additive disturbance), and the records. The name is refused where
        the confidence interval of this margin lies below zero.
    """

    name: str
    variants: Callable
    law: str
    experiment: str
    additive: bool = False
    picture: str | None = None
    plausible: Callable | None = None

    def tried(self, tree, additive):
        """Return the effect with the variants that are tried in a model, or None.

        Driven effects are tried before additive disturbances. An additive effect may have variants
        of both kinds: a disturbance of the response, which is a function of time alone, or a force
        within the equation of motion, which is a parameter of the model.

        Parameters
        ----------
        tree : Tree
            The model.
        additive : bool
            Whether additive disturbances are tried, or all other variants.

        Returns
        -------
        Effect or None
            With the variants that are tried; None if there are none.
        """
        if not self.additive:
            return None if additive else self
        forms = [v for v in self.variants() if hasattr(v, "trees") != additive]
        if not additive:
            forms = [v for v in forms if v.places(tree)]
        return replace(self, variants=partial(list, forms), additive=additive) if forms else None

    def __reduce_ex__(self, protocol):
        if any(
            effect is self for effect in _BUILT_IN
        ):  # pickled by name: its lambdas cannot be pickled
            return _built_in, (self.name,)
        return super().__reduce_ex__(protocol)


def _built_in(name):
    return next(effect for effect in _BUILT_IN if effect.name == name)


def _clips(place):
    return [Saturation(sides=side, place=place) for side in ("upper", "lower", "both")]


def _in_between(model):
    return [InBetween(model), InBetween(model, with_zeros=True)]


def _of_free_mass(**forces):
    # a constant force is an effect of its own, "offset"
    return MoreTerms(FreeMass(**({"fit_force_offset": False} | forces)))


def _knees():
    return [Knee(SoftSaturation(fit_center=center)) for center in (False, True)]


# functions return the variants, so that no two searches share a model
_BUILT_IN = (
    Effect(
        "hysteresis",
        lambda: [
            InMotion(RestoringForce(1, damping_degree=1)),
            InMotion(BoucWenStage()),
            InMotion(BoucWenStage(fit_exponent=True)),
            # forms of friction, too: `builds_up` and `slides` tell the two names apart
            ParallelForce(Dahl(fit_damping=False, fit_intercept=False), with_gain=True),
            ParallelForce(BoucWen(fit_gain=False, fit_intercept=False)),
            ParallelForce(MaxwellSlip(10)),
            FirstHysteresis(PrandtlIshlinskii(10)),
            FirstHysteresis(PrandtlIshlinskii(10), behind=True),
        ],
        "The response depends on earlier turning points of the drive, or of the motion.",
        "Sweep slowly up and down with several turning points: the branches stay apart at any "
        "rate.",
        picture="loop",
        plausible=builds_up,
    ),
    Effect(
        "input_saturation",
        lambda: [
            *_clips("drive"),
            SoftSaturation(place="drive", fit_center=False),
            SoftSaturation(place="drive"),
        ],
        "The drive is clipped before it reaches the actuator.",
        "Drive beyond the suspected level in both directions: the loop then repeats unchanged.",
        plausible=levels_off,
    ),
    Effect(
        "dead_zone",
        lambda: [DeadBand(), AtJoints(DeadBand()), *_in_between(DeadBand())],
        "The actuator does not respond while the drive is within a band.",
        "Repeat at smaller amplitude: the gain falls, to zero within the band.",
        plausible=input_beyond_dead_zone,
    ),
    Effect(
        "backlash",
        lambda: [
            Backlash(),
            Backlash(place="sensor"),
            AtJoints(Backlash(), inner=True),
            *_in_between(Backlash()),
        ],
        "Play in the transmission: after each reversal the drive crosses a gap first.",
        "Reverse at different levels: the lost motion is the same everywhere.",
        picture="loop",
        plausible=width_beyond_noise,
    ),
    Effect(
        "slew_limit",
        lambda: [SlewLimit()],
        "The drive reaches the actuator at a limited rate.",
        "Step by different heights: the edges have one slope, whatever the height.",
        picture="time",
    ),
    Effect(
        "rate_dependence",
        lambda: [
            RateDependence("threshold"),
            RateDependence("proportional"),
            RateDependence("slope"),
            RateDependence("threshold", "speed"),
            RateDependence("threshold", "velocity"),
            # not behind a low-pass of the signed rate: that follows the displacement since a
            # turning point, so that such weights imitate any hysteresis
            RateDependence("slope", "speed"),
        ],
        "The hysteresis itself changes with the rate of the drive.",
        "Repeat one loop at several rates: its width grows without the phase of linear dynamics.",
        picture="rate",
        plausible=varies_in_rate,
    ),
    Effect(
        "initial_state",
        lambda: [UnderWay()],
        "The device is not at rest when a record begins: its memory is of an earlier drive.",
        "Rest at the first value before each record, or drive to both ends of the range first.",
    ),
    Effect(
        "timing",
        lambda: [
            TimeShift(),
            HeldDrive("zoh"),
            HeldDrive("foh"),
            HeldDrive("bandlimited"),
            TimeShift(between="line"),
            TimeShift(fit_skew=True),
        ],
        "Drive and response are not sampled at once, or the drive differs between samples.",
        "Record one signal on both channels: a shift between them is due to the instruments.",
        picture="frequency",
        plausible=is_between_samples,
    ),
    Effect(
        "delay",
        lambda: [Delay()],
        "The response follows the drive after a pure shift in time.",
        "Sweep faster: the phase of a delay grows in proportion to frequency, the gain stays.",
        picture="frequency",
        plausible=delay_beyond_sampling,
    ),
    Effect(
        "asymmetry",
        lambda: [
            BehindHysteresis(DeadZones(n, sides=sides))
            for n in (1, 2, 3)
            for sides in ("upper", "lower", "both")
        ],
        "One-sided dead zones behind the hysteresis make its two branches curve differently.",
        "Sweep faster: dynamics behind the hysteresis separate a curve at the hysteresis from "
        "one at the sensor.",
        plausible=bends_to_one_side,
    ),
    Effect(
        "lag",
        # a mode, too: what is no lag is a resonance, by whether it has a peak
        lambda: [FirstOrderLag(), SecondOrderMode(), AtJoints(FirstOrderLag())],
        "A low-pass of first or second order, without a peak, delays and attenuates fast motion.",
        "Sweep to higher frequency: gain and phase fall together.",
        picture="frequency",
        plausible=has_no_peak,
    ),
    Effect(
        "resonance",
        lambda: [SecondOrderMode(), TransferFunction(n_poles=2, n_zeros=2)],
        "A second-order mode stores and returns energy.",
        "Apply a step or a sweep through the frequency and watch it ring.",
        picture="frequency",
        plausible=rings,
    ),
    Effect(
        "friction",
        lambda: [
            InMotion(FrictionStage(stribeck=False, fit_bristle_damping=False)),
            InMotion(FrictionStage(fit_bristle_damping=False)),
            InMotion(FrictionStage()),
            InMotion(FrictionStage(False, fit_bristle_damping=False, friction_gradient=True)),
            ParallelForce(Dahl(fit_damping=False, fit_intercept=False), with_gain=True),
            ParallelForce(BoucWen("fit", fit_gain=False, fit_intercept=False), with_gain=True),
            ParallelForce(CoulombFriction(fit_damping=False, fit_intercept=False)),
            ParallelForce(CoulombFriction(True, fit_damping=False, fit_intercept=False)),
            _of_free_mass(friction=True),
            _of_free_mass(friction=True, damping_asymmetry=True),
            _of_free_mass(friction=True, stribeck=True),
            _of_free_mass(friction=True, friction_gradient=True),
            LoadedForce(CoulombFriction(fit_damping=False, fit_intercept=False)),
            LoadedMotion(
                (
                    InMotion(FrictionStage(stribeck=False, fit_bristle_damping=False)),
                    _of_free_mass(friction=True),
                )
            ),
        ],
        "A force against the motion that hardly depends on its speed.",
        "Move at several constant speeds in both directions: the force jumps with the direction.",
        picture="velocity",
        plausible=slides,
    ),
    Effect(
        "cubic_stiffness",
        lambda: [
            InMotion(RestoringForce(3, damping_degree=1, fit_hysteresis=False, fit_preload=False)),
            InMotion(RestoringForce(3, damping_degree=1, fit_hysteresis=False)),
            InFeedback(SmoothCurve(3)),
            _of_free_mass(cubic_stiffness=True),
        ],
        "The spring hardens or softens with the displacement.",
        "Sweep at several amplitudes: the resonance moves, and a third harmonic appears.",
        picture="displacement",
    ),
    Effect(
        "end_stops",
        # one stop first: two explain whatever one does
        lambda: (
            [
                InMotion(EndStops(sides, fit_stop_damping=damped))
                for damped in (False, True)
                for sides in ("lower", "upper", "both")
            ]
            + [
                _of_free_mass(lower_stop=lower, upper_stop=upper, fit_stop_damping=damped)
                for damped in (False, True)
                for lower, upper in ((True, False), (False, True), (True, True))
            ]
        ),
        "Beyond a gap the motion runs against a stop, far stiffer than the spring.",
        "Drive slowly beyond the suspected stop: the response hardly grows.",
        picture="displacement",
        plausible=stops,
    ),
    Effect(
        "creep",
        lambda: [
            *(KelvinVoigt(n) for n in (1, 2, 3)),
            AtJoints(KelvinVoigt(1)),
            BesideHysteresis(FirstOrderLag(fit_intercept=False)),
        ],
        "The response continues to relax after each change of the drive, over decades of time.",
        "Step and rest: hold the drive for much longer than the slowest motion so far.",
        picture="relaxation",
        plausible=responds_promptly,
    ),
    Effect(
        "static_nonlinearity",
        lambda: [
            *(SmoothCurve(degree) for degree in (2, 3, 5, 7, 9)),
            *_knees(),
            InStages(overflow=False, fit_exponents=False),
            InStages(overflow=False, fit_exponents=True),
            AtJoints(SmoothCurve(3)),
            AtJoints(SmoothCurve(9)),
            AtJoints(Saturation(), inner=True),
            # what passes would be the gain that the hysteresis has already
            BesideHysteresis(SmoothCurve(3, passes=False)),
            BesideHysteresis(SmoothCurve(9, passes=False)),
            InBetween(SmoothCurve(3)),
            *_in_between(SmoothCurve(9)),
            *_in_between(Saturation()),
        ],
        "The reading, or the signal between two stages, passes a memoryless curve.",
        "Calibrate the sensor on its own, or sweep faster: a curve at the sensor acts behind the "
        "dynamics.",
        plausible=bends,
    ),
    Effect(
        "output_saturation",
        lambda: [
            *_clips("sensor"),
            *_knees(),
            InStages(overflow=True, fit_exponents=False),
            InStages(overflow=True, fit_exponents=True),
        ],
        "The reading is clipped at a level.",
        "Shift the working point by a known amount: the level stays with the reading.",
        plausible=levels_off,
    ),
    Effect(
        "rectification",
        lambda: [Folded(Fold("lower")), Folded(Fold("upper"))],
        "The reading folds back at a level, as that of a sensor that loses the sign.",
        "Drive slowly through the level: the reading reverses while the drive does not.",
    ),
    Effect(
        "amplitude_dependence",
        lambda: [
            Scaling("amplitude"),
            PerRecord("amplitude", "dynamics"),
            PerRecord("amplitude", "all"),
            MovedModes(1),
            MovedModes(2),
            MovedModes(3),
            MovedModes(5),
        ],
        "Parameters depend on the amplitude of the record.",
        "Record small, medium and large amplitudes with the same kind of drive.",
    ),
    Effect(
        "auxiliary_input",
        lambda: [
            Driven(Gain(fit_intercept=False)),  # a constant is an "offset", no further input
            Driven(Gain(fit_intercept=False), to_drive=True),
            Driven(FirstOrderLag(fit_intercept=False)),
            Driven(FirstOrderLag(fit_intercept=False), to_drive=True),
            Scaling("column"),
            Scaling("column", lagged=True),
            FollowedWidth(),
            PerRecord("column", "all"),
        ],
        "A further measured quantity acts on the response, or on what drives it.",
        "Change that quantity alone, at rest and in motion.",
    ),
    Effect(
        "offset",
        lambda: [Offset(), _of_free_mass(fit_force_offset=True)],
        "Each record has a constant offset, or a constant force adds to the drive.",
        "Repeat a record after setting up the sensor anew.",
        additive=True,
    ),
    Effect(
        "drift",
        # the force is no function of time alone, so that it is tried with the driven effects
        lambda: [*(Drift(degree) for degree in (1, 3, 8)), _of_free_mass(fit_force_drift=True)],
        "The response drifts slowly, whatever the drive does, or a force that does adds to it.",
        "Rest at a constant drive for as long as a record takes.",
        additive=True,
    ),
    Effect(
        "periodic_disturbance",
        lambda: [PeriodicDisturbance(n) for n in (1, 2, 3)],
        "Sinusoids whose frequencies do not depend on the drive add to the response.",
        "Record at rest: the lines remain when the drive does not move.",
        additive=True,
        picture="spectrum",
        plausible=has_own_lines,
    ),
)

EFFECTS = {effect.name: effect for effect in _BUILT_IN}


def register_effect(effect) -> None:
    """Make an effect of your own known to every later search under its name.

    Parameters
    ----------
    effect : Effect
        With parametric models of skhyst, or of your own.

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


def unregister_effect(name) -> None:
    """Remove an effect that was registered.

    Parameters
    ----------
    name : str
        Name of the effect.

    Raises
    ------
    ValueError
        If no effect has this name.

    Examples
    --------
    >>> from skhyst.diagnosis import Effect, effect_names, register_effect, unregister_effect
    >>> from skhyst.linear import TransferFunction
    >>> variants = lambda: [TransferFunction(n_poles=3)]
    >>> register_effect(Effect("third_order", variants, "A mode and a lag.", "Sweep further."))
    >>> unregister_effect("third_order")
    >>> "third_order" in effect_names()
    False
    """
    if name not in EFFECTS:
        raise ValueError(f"No effect is named '{name}'. There are: {', '.join(EFFECTS)}.")
    del EFFECTS[name]


def effect_names() -> list[str]:
    """Return the names of all effects that a search tries.

    Returns
    -------
    list of str
        Built-in effects first, then the registered ones.

    Examples
    --------
    >>> from skhyst.diagnosis import effect_names
    >>> "creep" in effect_names()
    True
    """
    return list(EFFECTS)


def chosen_effects(names):
    """Return the effects that the parameter `effects` of a search names."""
    names = np.ravel(names).tolist()
    names = list(EFFECTS) if names == ["all"] else names
    unknown = [name for name in names if name not in EFFECTS]
    if unknown:
        near = get_close_matches(str(unknown[0]), EFFECTS, cutoff=0.0)
        raise ValueError(
            "The 'effects' parameter of EffectSearchCV must be 'all' or names among those of "
            f"effect_names(), such as {', '.join(near)}. Got {', '.join(map(repr, unknown))} "
            "instead."
        )
    return [EFFECTS[name] for name in names]
