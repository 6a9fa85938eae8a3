"""Draw the cheat sheet: one page of A4, landscape.

`PYTHONPATH=benchmarks python docs/cheat_sheet.py FILE.pdf`
"""

import sys

import matplotlib.pyplot as plt
from signatures import BOTH, DOWN, STYLE, UP

__all__ = ["draw_cheat_sheet"]

COLUMNS = [
    [
        (
            "Read a recording",
            """X, y = read_records("run.csv", drive="voltage",
    response="position", time="t", time_unit="ms")
X, y = stack_records([(u1, y1), (u2, y2)], dt=1e-4)
X, y = resample_records(X, y, dt="auto")
data_quality(X, y, record_slices(X))""",
        ),
        (
            "Search",
            """search = EffectSearchCV(PrandtlIshlinskii(),
    effects="all", n_jobs=2, random_state=0)
search.fit(X, y)
search.effects_          # names, [] if none
search.verdict_          # is the residual noise?
search.error_before_     # held out, units of y
search.error_after_, search.noise_floor_
search.history_          # p-values, ambiguous_with
search.evidence_["creep"].statement
search.report().to_html("report.html")
search.best_estimator_   # the model to keep
search.held_out_error(X_new, y_new)""",
        ),
        (
            "What to record next",
            """next_experiment(search, drive_limits=(0, 100),
    rate_limit=2000, duration=2, dt=1e-3
    ).save("drive.csv")""",
        ),
    ],
    [
        (
            "Models",
            """PrandtlIshlinskii(20)    ModifiedPrandtlIshlinskii()
BoucWen()  Preisach()    JilesAtherton()  Dahl()
LuGre()    MaxwellSlip() CoulombFriction()  FreeMass()
SecondOrderMode()  TransferFunction(4)  ModalModel(28)
KelvinVoigt(2)  FirstOrderLag()  Delay()
FrictionStage()  BoucWenStage()  RestoringForce()
NARXRegressor(...)  SCNRegressor()""",
        ),
        (
            "Compose",
            """Cascade([("loop", PrandtlIshlinskii()),
         ("mode", TransferFunction(2))])   # series
Sum([("stage", stage), ("drift", Drift())])  # parallel
ScheduledParameters(model, by="current")
FrozenEstimator(fitted)     # fix a step""",
        ),
        (
            "Use",
            """model.fit(X, y).predict(X)    # free run
model.score(X, y)             # R2 of the free run
model.params_, model.params_std_, model.identifiability_
cross_validate(model, X, y, cv=RecordKFold(5))
stepper = model.stepper(dt=1e-4); stepper.step(u)""",
        ),
        (
            "Look",
            """HysteresisLoopDisplay.from_search(search)
ResidualDisplay.from_search(search)
FrequencyResponseDisplay.from_recording(X, y)""",
        ),
    ],
    [
        (
            "Save, invert, export",
            """save_model(model, "m.skops"); load_model("m.skops")
from_json(to_json(model))
inverse = InverseCompensator(model).fit(X, y)
drive = inverse.predict(reference[:, None])
simulate_loop(device, FeedforwardPI(kp, ki,
    compensator=inverse), reference, dt=1e-4)
to_c(model, "controller", "stage_x", dtype="float32")
to_fmu(model, "stage_x.fmu")""",
        ),
        (
            "Command line",
            """skhyst inspect run.csv
skhyst diagnose run.csv --drive u --response y --time t
  --model prandtl_ishlinskii --report r.html
  --save m.skops
skhyst next run.csv ... -o drive.csv --limits 0 100
skhyst compensate m.skops reference.csv -o drive.csv
skhyst export m.skops --c controller --name stage_x
skhyst models; skhyst effects; skhyst demo; skhyst app""",
        ),
        (
            "Effects, in the order of the signal",
            """at the drive   input_saturation dead_zone backlash
               slew_limit delay timing initial_state
in the loop    hysteresis rate_dependence asymmetry
dynamics       lag resonance creep
forces         friction cubic_stiffness end_stops
at the sensor  static_nonlinearity output_saturation
               rectification
parameters     amplitude_dependence auxiliary_input
additive       offset drift periodic_disturbance""",
        ),
    ],
]
DATE = {"pdf": "CreationDate", "svg": "Date"}  # left out, so that the files are reproducible
SIZE = 11.69, 8.27  # inches
LINE, TITLE, GAP = 0.0224, 0.034, 0.04  # of the page's height
TEXT = {"family": "monospace", "fontsize": 7.6, "linespacing": 1.75, "parse_math": False}


def draw_cheat_sheet(path):
    """Draw the page into a PDF or SVG file."""
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=SIZE)
        figure.text(0.03, 0.955, "skhyst", fontsize=20, fontweight="bold", color=BOTH, va="center")
        line = "declare a model, analyse the residual, name what is missing"
        figure.text(0.125, 0.952, line, fontsize=11, color=UP, va="center")
        for number, column in enumerate(COLUMNS):
            left, top = 0.03 + 0.325 * number, 0.91
            for title, text in column:
                options = {"fontsize": 10, "fontweight": "bold", "color": DOWN, "va": "top"}
                figure.text(left, top, title, **options)
                figure.text(left, top - TITLE, text, color=BOTH, va="top", **TEXT)
                top -= TITLE + GAP + LINE * len(text.splitlines())
        figure.savefig(path, metadata={DATE[str(path)[-3:]]: None})
        plt.close(figure)


if __name__ == "__main__":
    draw_cheat_sheet(sys.argv[1])
