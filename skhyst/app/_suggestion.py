"""Suggestion of the model to declare, from the answers to three questions.

Effects that are known belong in the declared model. Unknown ones are left out: if the device has
them, the search finds them.
"""

from dataclasses import dataclass

DEVICES = {
    "piezo": "A piezo stage, a shape-memory wire or another actuator with a loop",
    "magnetic": "A magnetic core or a magnetostrictive actuator",
    "play": "A gear, a tendon or a joint with play",
    "force": "A damper or a joint: the drive is a motion, the response is the force",
    "flow": "Tanks or valves: a level or a pressure follows a flow",
    "linear": "A mechanism or a circuit without a loop, as far as I know",
}
"""Kinds of devices: keys and their descriptions."""

_LAG, _MODE = "first_order_lag", "second_order_mode"
_MODELS = {  # quasi-static; with rate dependence; with a resonance
    "piezo": ("prandtl_ishlinskii", f"prandtl_ishlinskii+{_LAG}", f"prandtl_ishlinskii+{_MODE}"),
    "magnetic": ("prandtl_ishlinskii", f"prandtl_ishlinskii+{_LAG}", f"prandtl_ishlinskii+{_MODE}"),
    "play": ("backlash", f"backlash+{_LAG}", f"backlash+{_MODE}"),
    "force": (
        "coulomb_friction",
        "dynamic_stiffness(fit_mass=False, fit_stiffness=False)",
        "dynamic_stiffness",
    ),
    "flow": ("gain", "transfer_function(n_poles=2)", "transfer_function(n_poles=2)"),
    "linear": ("gain", _LAG, _MODE),
}
_REASONS = {
    "prandtl_ishlinskii": "play operators make loops that depend on the turning points alone",
    "backlash": "the response follows the drive once half the gap is used up",
    "coulomb_friction": "a force that changes its sign with the velocity, whatever its size",
    "dynamic_stiffness": "the equation of motion, read as a force: mass, dashpot and spring",
    "dynamic_stiffness(fit_mass=False, fit_stiffness=False)": "a dashpot: the force grows with "
    "the velocity",
    "transfer_function(n_poles=2)": "two stores that fill and empty one after the other",
    "gain": "the response is proportional to the drive; memory is named where there is any",
    _LAG: "what lags behind a fast drive, gain and phase falling together",
    _MODE: "mass, spring and damper: it overshoots and rings after a step",
}


@dataclass(frozen=True)
class Suggestion:
    """A model to declare.

    Parameters
    ----------
    model : str
        As :func:`skhyst.discovery.parse_model` takes it.
    reason : str
        What each stage represents, and which effects are left to the search.
    """

    model: str
    reason: str


def suggest_model(moves, *, rate_matters=None, rings=None) -> Suggestion:
    """Suggest the model to declare for a device.

    Parameters
    ----------
    moves : str
        What moves, a key of :data:`DEVICES`.
    rate_matters, rings : bool or None, default=None
        Whether the response depends on the rate of the drive, and whether the device has a
        resonance in the band of the drive. None: not known, and so left to the search.

    Returns
    -------
    Suggestion

    Raises
    ------
    ValueError
        If ``moves`` is not a key of :data:`DEVICES`.

    Examples
    --------
    >>> from skhyst.app import suggest_model
    >>> suggest_model("piezo", rings=True).model
    'prandtl_ishlinskii+second_order_mode'
    >>> suggest_model("piezo").reason
    'Play operators make loops that depend on the turning points alone. Dynamics are left out: ...'
    """
    if moves not in _MODELS:
        raise ValueError(
            f"The 'moves' parameter of suggest_model must be one of {', '.join(DEVICES)}. Got "
            f"{moves!r} instead."
        )
    model = _MODELS[moves][2 if rings else bool(rate_matters)]
    reason = "; then ".join(_REASONS[stage] for stage in model.split("+"))
    reason = f"{reason[0].upper()}{reason[1:]}."
    if model == _MODELS[moves][0]:
        reason += " Dynamics are left out: where they are missing, the search names them."
    return Suggestion(model, reason)
