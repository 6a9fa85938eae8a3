"""An instance of every public estimator, as small as the tests of all estimators can do with."""

from sklearn.linear_model import Ridge

from skhyst.autoregressive import NARMAXRegressor
from skhyst.compose import (
    Cascade,
    Corrected,
    Feedback,
    Modulated,
    OnColumn,
    ScheduledParameters,
    SharedParameters,
    Sum,
)
from skhyst.control import InverseCompensator, Monitor, Observer
from skhyst.diagnosis import EffectSearchCV
from skhyst.discovery import all_estimators
from skhyst.disturbance import Offset
from skhyst.fleet import PerDevice
from skhyst.hysteresis import (
    BoucWenStage,
    EndStops,
    FreeMass,
    FrictionStage,
    PrandtlIshlinskii,
    RestoringForce,
)
from skhyst.linear import FirstOrderLag, KelvinVoigt
from skhyst.neural import GrayBoxHysteresis
from skhyst.optimize import LevenbergMarquardt, VariableProjection
from skhyst.static import SmoothCurve

__all__ = ["NO_GAIN", "SLOW", "small_estimators"]

_BRIEFLY = VariableProjection(max_evaluations=3)  # on what is no response of theirs

_EXAMPLES = {
    "Cascade": lambda: Cascade([("hysteresis", PrandtlIshlinskii(5)), ("lag", FirstOrderLag())]),
    "Sum": lambda: Sum([("hysteresis", PrandtlIshlinskii(5)), ("offset", Offset())]),
    "Feedback": lambda: Feedback(FirstOrderLag(), SmoothCurve(2), n_substeps=1),
    "ScheduledParameters": lambda: ScheduledParameters(PrandtlIshlinskii(5)),
    "SharedParameters": lambda: SharedParameters(PrandtlIshlinskii(5)),
    "InverseCompensator": lambda: InverseCompensator(  # at any drive: by default it is limited
        Ridge(), method="learned", drive_limits=(-1e300, 1e300), rate_limit=1e300
    ),
    "Observer": lambda: Observer(FirstOrderLag()),
    "Monitor": lambda: Monitor(Observer(FirstOrderLag())),
    "Corrected": lambda: Corrected(Ridge(), FirstOrderLag(), cv=2, max_iter=1),
    "OnColumn": lambda: OnColumn(PrandtlIshlinskii(5), 0),
    "Modulated": lambda: Modulated(PrandtlIshlinskii(5), "amplitude"),
    "PerDevice": lambda: PerDevice(PrandtlIshlinskii(5)),
    "KelvinVoigt": lambda: KelvinVoigt(1),
    "BoucWenStage": lambda: BoucWenStage(n_substeps=1, initial_state="zero"),
    "EndStops": lambda: EndStops(n_substeps=1, initial_state="zero"),
    "FreeMass": lambda: FreeMass(initial_state="zero", method=_BRIEFLY),
    "FrictionStage": lambda: FrictionStage(False, n_substeps=1, initial_state="zero"),
    "RestoringForce": lambda: RestoringForce(
        1, damping_degree=1, n_substeps=1, initial_state="zero"
    ),
    # on data without dynamics it would choose no term, or none with memory
    "NARMAXRegressor": lambda: NARMAXRegressor(1, n_terms=None),
    "GrayBoxHysteresis": lambda: GrayBoxHysteresis(method=LevenbergMarquardt(max_epochs=20)),
    # plays that such data do not show would be left out, and with them all memory
    "EffectSearchCV": lambda: EffectSearchCV(
        FirstOrderLag(), effects=["lag", "offset"], cv=2, max_effects=1
    ),
}

# the response has the unit of the drive, so that it cannot be scaled alone
NO_GAIN = {
    "Backlash",
    "DeadBand",
    "Delay",
    "DeadZones",
    "Fold",
    "Saturation",
    "SlewLimit",
    "SmoothCurve",
    "SoftSaturation",
    "TimeShift",
}

# a fit takes a fifth of a second or more; quicker ones are made of the same parts
SLOW = {
    "BoucWenStage",
    "EffectSearchCV",
    "EndStops",
    "FreeMass",
    "FrictionStage",
    "Monitor",
    "Observer",
    "RestoringForce",
    "SCNRegressor",
}


def small_estimators():
    """Return name -> new instance, sorted by name."""
    found = {name: _EXAMPLES.get(name, cls)() for name, cls in all_estimators()}
    for estimator in found.values():
        if getattr(estimator, "method", None) == "variable_projection":
            estimator.set_params(method=_BRIEFLY)
    return found
