"""The command line: argparse over the public interface.

Exit codes: 0 done; 1 the data or the options do not fit together, or a file cannot be read or
written; 2 the call is wrong; 130 interrupted. Results go to the standard output, progress and
errors to the standard error stream.
"""

import argparse
import ast
import difflib
import importlib.util
import inspect
import math
import shlex
import sys
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

from . import __version__
from ._demo import make_demo_recording
from ._export_command import add_export
from ._files import check_outputs, replacing
from ._model_files import load_model, save_model
from .base import ParametricModel
from .compose import Cascade, snake_case
from .control import InverseCompensator
from .diagnosis import EFFECTS, EffectSearchCV, Report, effect_names, next_experiment
from .discovery import all_estimators
from .exceptions import ReachWarning
from .records import read_records, record_slices

__all__ = ["main", "parse_model"]

_LEFT = {
    "noise": "noise",
    "undetermined": "perhaps noise; the recording cannot tell",
    "unexplained": "structure that no effect explains",
}
_DRAWN = ("jinja2", "matplotlib")
_REPORTS = {".html": _DRAWN, ".htm": _DRAWN, ".md": ("jinja2",)}
_NEEDED = {suffix: (modules, "plot") for suffix, modules in _REPORTS.items()}
_NEEDED[".skops"] = (("skops",), "io")  # what a file's suffix needs, and the extra that has it
_READING = (  # options that are parameters of read_records
    *("drive", "response", "time", "time_unit", "record", "auxiliary", "sampling_rate"),
    *("on_missing", "missing_code", "delimiter", "decimal"),
)


def main(argv=None):
    """Run the command line; return the exit code.

    Parameters
    ----------
    argv : list of str, optional
        Arguments, without the name of the program.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    options = _parser().parse_args(argv)
    options.command = shlex.join(["skhyst", *argv])
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            options.run(options)
    except KeyboardInterrupt:
        print("skhyst: interrupted", file=sys.stderr)
        return 130
    except (ValueError, TypeError, OSError, ImportError, NotImplementedError) as error:
        print(f"skhyst: {error}", file=sys.stderr)
        return 1
    return 0


def _show_warning(message, *args, **options):
    """Print a warning without the line of source that it came from."""
    print(f"skhyst: {message}", file=sys.stderr)


def _parser():
    parser = argparse.ArgumentParser(
        prog="skhyst",
        description="Find the physical effect that a declared model lacks; put models to use.",
    )
    parser.add_argument("--version", action="version", version=f"skhyst {__version__}")
    commands = parser.add_subparsers(dest="subcommand", required=True, metavar="command")
    _add_diagnose(commands)
    _add_next(commands)
    _add_compensate(commands)
    _add_model(add_export(commands))
    demo = commands.add_parser("demo", help="hide an effect in a simulated actuator, then find it")
    add = demo.add_argument
    add("--output", type=Path, default=Path("skhyst_demo"), help="folder for the files")
    add("--seed", type=int, default=0, help="chooses the actuator and the effect")
    add("--jobs", type=int, default=-1, help="processes (default: all processors)")
    add("--quiet", action="store_true", help="no progress")
    demo.set_defaults(run=_demo)
    for command in tuple(commands.choices.values()):
        command.add_argument("--force", action="store_true", help="write over files that are there")
    for name, listed, run in (
        ("models", "models that can be declared", _list_models),
        ("effects", "effects that a search tries", _list_effects),
    ):
        commands.add_parser(name, help=f"list the {listed}").set_defaults(run=run)
    return parser


def _add_diagnose(commands):
    parser = commands.add_parser("diagnose", help="search a recording for missing effects")
    _add_search(parser)
    parser.set_defaults(run=_diagnose)


def _add_next(commands):
    about = "search a recording, and write the drive to record next"
    parser = commands.add_parser("next", help=about)
    _add_search(parser)
    add = parser.add_argument
    add("-o", "--output", type=Path, required=True, metavar="FILE", help="time and drive, csv")
    limits = "of the drive, in its units"
    add("--limits", type=float, nargs=2, required=True, metavar=("LOW", "HIGH"), help=limits)
    add("--rate", type=float, metavar="R", help="largest slope, units of the drive over s")
    longest = "default: as the longest record"
    add("--duration", type=float, metavar="S", help=f"length in s ({longest})")
    add("--dt", type=float, metavar="S", help=f"sampling interval ({longest})")
    parser.set_defaults(run=_next)


def _next(options):
    if not options.limits[0] < options.limits[1]:
        raise ValueError(f"The limits must be LOW HIGH. Got {options.limits} instead.")
    search = _diagnose(options)
    asked = options.limits, options.rate, options.duration, options.dt
    experiment = next_experiment(search, *asked)
    experiment.save(options.output, force=options.force)
    print(f"record next: {experiment.reason}")
    print(f"written: {options.output}")


def _add_search(parser):
    add = parser.add_argument
    add("file", type=Path, help="recording: csv, txt, mat, npy, npz, json, hdf5, parquet, tdms")
    add("--drive", required=True, metavar="COL", help="column or variable of the drive")
    add("--response", required=True, metavar="COL", help="column or variable of the response")
    add("--time", metavar="COL", help="column of the time")
    add("--time-unit", help="unit of the time (default: that which the file says, else s)")
    unit = "unit of a column that the file does not say; repeatable"
    add("--unit", metavar="COL=UNIT", action="append", default=[], help=unit)
    add("--record", metavar="COL", help="column that labels the records")
    add("--auxiliary", metavar="COL", action="append", default=[], help="further input; repeatable")
    loop = "column of the reference that the controller followed, where there was one"
    add("--reference", metavar="COL", help=loop)
    add("--sampling-rate", type=float, metavar="HZ", help="instead of --time")
    add("--missing-code", type=float, help="value that marks a lost reading")
    add("--on-missing", choices=("raise", "drop", "interpolate"), default="raise")
    add("--delimiter", metavar="CHAR", help="of a text, where it is not found")
    add("--decimal", choices=(".", ","), help="decimal sign of a text, where it is not found")
    add("--rows", metavar="A:B", help="use these rows of the file only, counted from 0")
    grid = "interpolate unevenly sampled records onto even grids, of their own or of S s"
    add("--resample", type=_grid, metavar="auto|S", help=grid)
    rest = "search the first part (of the records, or of the only one), report on the rest"
    add("--train-fraction", type=float, metavar="F", help=rest)
    series = "declared model, in series with +: prandtl_ishlinskii+transfer_function(n_poles=2)"
    add("--model", default="prandtl_ishlinskii", metavar="NAME", help=series)
    add("--effects", default="all", help="comma-separated names (default: all)")
    add("--folds", "--cv", type=int, default=5, metavar="N", help="folds (default: 5)")
    add("--washout", type=int, metavar="N", help="samples at a start that are not scored")
    gross = "huber: gross errors of the measurement count less (default: squared)"
    add("--loss", choices=("squared", "huber"), default="squared", help=gross)
    add("--alpha", type=float, default=0.01, help="probability of a false claim (default: 0.01)")
    add("--max-effects", type=int, default=3, help="claims at the most (default: 3)")
    add("--seed", type=int, default=0, help="seed (default: 0)")
    add("--jobs", type=int, default=-1, help="processes (default: all processors)")
    add("--report", type=Path, metavar="FILE", help="report, .html or .md")
    add("--save", type=Path, metavar="FILE", help="augmented model, .skops or .joblib")
    add("--json", type=Path, metavar="FILE", help="numbers")
    add("--quiet", action="store_true", help="no progress")


def _add_model(parser):
    add = parser.add_argument
    add("model", type=Path, help="fitted model, .skops; others with --trust")
    trust = "load a pickle, or what skops does not know: it can run any code"
    add("--trust", action="store_true", help=trust)


def _add_compensate(commands):
    about = "the drive under which a fitted model follows a reference"
    parser = commands.add_parser("compensate", help=about)
    _add_model(parser)
    add = parser.add_argument
    add("file", type=Path, help="reference: csv or another format that diagnose reads")
    add("-o", "--output", type=Path, required=True, metavar="FILE", help="time and drive, csv")
    add("--time", default=0, metavar="COL", help="column of the time (default: the first)")
    add("--time-unit", help="unit of the time (default: that which the file says, else s)")
    column = "column of the reference (default: the second)"
    add("--reference", default=1, metavar="COL", help=column)
    limits = "of the drive, in its units"
    add("--limits", type=float, nargs=2, metavar=("LOW", "HIGH"), help=limits)
    faster = "leave out what is faster in the reference"
    add("--bandwidth", type=float, metavar="HZ", help=faster)
    parser.set_defaults(run=_compensate)


def _compensate(options):
    check_outputs([options.output], [options.model, options.file], force=options.force)
    model = load_model(options.model, options.trust)
    columns = {"drive": options.reference, "time": options.time, "time_unit": options.time_unit}
    X, _ = read_records(options.file, **columns)
    reference = X.iloc[:, 0]
    compensator = InverseCompensator(
        model, bandwidth=options.bandwidth, drive_limits=options.limits
    ).fit(X, reference)  # the model is fitted: nothing is learned from the reference
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ReachWarning)
        drive, residual = compensator.predict(X, return_residual=True)
    span = np.ptp(reference) / 100.0 or 1.0
    worst = np.abs(residual).max()
    print(f"largest residual of the model: {worst:.4g} ({worst / span:.3g} % of the range)")
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        print(message)
    table = pd.DataFrame({"drive": drive}, X.index).reset_index()
    single = table["record"].nunique() == 1
    with replacing(options.output) as (part,):
        table.drop(columns="record" if single else []).to_csv(part, index=False)
    print(f"written: {options.output}")


def _diagnose(options):
    model = parse_model(options.model)
    outputs = [options.report, options.save, options.json, getattr(options, "output", None)]
    if options.report and options.report.suffix.lower() not in _REPORTS:
        raise ValueError(f"The report must end in .html or .md. Got {options.report} instead.")
    _prepare([path for path in outputs if path], [options.file], options)
    reading = {name: getattr(options, name) for name in _READING}
    reading["units"] = dict(_unit(text) for text in options.unit)
    if options.reference is not None:
        reading["auxiliary"] = [*options.auxiliary, options.reference]
    X, y = read_records(options.file, **reading)
    if options.rows:
        rows = _rows(options.rows)
        X, y = X.iloc[rows], y.iloc[rows]
    held_out = None
    if options.train_fraction is not None:
        n = _training_rows(X, options.train_fraction, uneven=options.resample is not None)
        X, y, held_out = X.iloc[:n], y.iloc[:n], (X.iloc[n:], y.iloc[n:])
    effects = options.effects if options.effects == "all" else options.effects.split(",")
    more = {"effects": effects, "cv": options.folds, "alpha": options.alpha}
    more |= {"max_effects": options.max_effects, "resample": options.resample}
    more |= {"washout": options.washout, "loss": options.loss}
    more["reference"] = None if options.reference is None else X.shape[1] - 1
    search = _search(model, options, **more).fit(X, y)
    _conclude(search, options, held_out)
    return search


def _search(model, options, **more):
    quiet = {"n_jobs": options.jobs, "verbose": int(not options.quiet)}
    return EffectSearchCV(model, random_state=options.seed, **quiet, **more)


def _demo(options):
    recording = options.output / "recording.csv"
    outputs = [options.output / name for name in ("report.html", "model.joblib", "result.json")]
    options.report, options.save, options.json = outputs
    _prepare([recording, *outputs], [], options)
    table, secret, description = make_demo_recording(options.seed)
    with replacing(recording) as (part,):
        table.to_csv(part, index=False)
    print(f"A piezo actuator was simulated and recorded in {recording}.")
    print("The model is Prandtl-Ishlinskii; the search sees the recording and nothing else.")
    columns = {"drive": "voltage", "response": "position", "time": "time", "record": "record"}
    X, y = read_records(recording, **columns)
    search = _search(parse_model("prandtl_ishlinskii"), options).fit(X, y)
    _conclude(search, options, None)
    print(f"What had been put in: {secret}, {description}.")


def _conclude(search, options, held_out):
    """Print the result and write the files; a file that fails takes no other with it."""
    span, unit = np.ptp(search.response_) / 100.0 or 1.0, f" {search.units_.response}".rstrip()
    print(f"missing: {', '.join(search.effects_) or 'nothing'}")
    for row in search.history_.itertuples():
        print(f"  {row.effect}: {row.evidence.statement}")
        if row.ambiguous_with:
            print(f"    not told apart from: {', '.join(row.ambiguous_with)}. {row.experiment}")
        if row.provisional:
            print("    provisional: more than half of the structure before it is left")
    print(
        f"held-out error: {search.error_before_:.4g} -> {search.error_after_:.4g}{unit} "
        f"({search.error_before_ / span:.3g} % -> {search.error_after_ / span:.3g} % of the "
        f"range), noise floor {search.noise_floor_:.4g}{unit}"
    )
    print(f"what is left: {_LEFT[search.verdict_]}")
    print(f"its noise: {search.noise_model_}")
    if search.units_.time == "sample":
        print("no time is known: give --time or --sampling-rate for s and Hz")
    if search.reference_share_ is not None:
        print(f"the reference foretells {100.0 * search.reference_share_:.3g} % of the drive")
    if search.resampling_error_:
        error = search.resampling_error_
        print(
            f"interpolation onto even grids changes the response by about {error:.4g}{unit} (RMS)"
        )
    if held_out is not None:
        before = search.held_out_error(*held_out, declared=True)
        after = search.held_out_error(*held_out)
        print(f"error on the part kept away from the search: {before:.4g} -> {after:.4g}{unit}")
    report = Report.from_search(search, command=options.command, held_out=held_out)
    is_markdown = options.report and options.report.suffix.lower() == ".md"
    outputs = (
        (options.save, lambda path: save_model(search.best_estimator_, path)),
        (options.json, report.to_json),
        (options.report, report.to_markdown if is_markdown else report.to_html),
    )
    failures = []
    for path, write in outputs:
        if path:
            try:
                check_outputs([path], force=options.force)  # the search has taken its time
                write(path)
            except OSError as error:
                failures.append(str(error))
            except TypeError as error:  # not to be written as skops
                failures.append(f"{path} cannot be written: {error}")
            else:
                print(f"written: {path}")
    if failures:
        raise OSError(" ".join(failures))


def parse_model(text):
    """Return the declared model that a text names.

    Parameters
    ----------
    text : str
        Class name or its snake case, with simple options in parentheses; ``+`` puts models in
        series. Nothing is evaluated but literals.

    Returns
    -------
    estimator

    Raises
    ------
    ValueError
        If the text names no model or an option is no literal.

    Examples
    --------
    >>> from skhyst.cli import parse_model
    >>> parse_model("prandtl_ishlinskii+transfer_function(n_poles=2)").named_steps.keys()
    dict_keys(['prandtl_ishlinskii', 'transfer_function'])
    """
    try:
        parts = _addends(ast.parse(text, mode="eval").body)
        models = [_model(part) for part in parts]
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise ValueError(
            f"The model {text!r} is not understood: give a name that skhyst models lists, with "
            "options in parentheses, and + between models in series."
        ) from error
    if len(models) == 1:
        return models[0]
    steps = []
    for model in models:
        name = snake_case(type(model).__name__)
        same = sum(step.rstrip("0123456789") == name for step, _ in steps)
        steps.append((f"{name}{same + 1}" if same else name, model))
    return Cascade(steps)


def _addends(node):
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return [*_addends(node.left), *_addends(node.right)]
    return [node]


def _model(node):
    call = isinstance(node, ast.Call)
    name = node.func if call else node
    found = _models().get(snake_case(getattr(name, "id", "")))
    if found is None:
        text = ast.unparse(name)
        raise ValueError(f"There is no model {text!r}: {_nearest(text)}")
    if not call:
        return found()
    try:
        positional = [ast.literal_eval(value) for value in node.args]
        named = {keyword.arg: ast.literal_eval(keyword.value) for keyword in node.keywords}
        return found(*positional, **named)
    except (ValueError, TypeError) as error:
        raise ValueError(f"The options of {ast.unparse(node)!r} do not fit: {error}") from error


def _models():
    """Return the models that can be declared, by their names in snake case."""
    return {
        snake_case(name): model
        for name, model in all_estimators()
        if issubclass(model, ParametricModel) and _stands_alone(model)
    }


def _stands_alone(model):
    """Whether a model needs no other, and responds to the drive."""
    parameters = inspect.signature(model).parameters.values()
    complete = all(parameter.default is not parameter.empty for parameter in parameters)
    return complete and not model.operator_class.stands_beside


def _nearest(name):
    """Return the names of models that are most like one."""
    near = difflib.get_close_matches(snake_case(name), _models(), cutoff=0.0)
    return f"did you mean {', '.join(near)}? skhyst models lists all."


def _list_models(options):
    about = {name: model.__doc__.strip().splitlines()[0] for name, model in _models().items()}
    _print_aligned(dict(sorted(about.items())))


def _list_effects(options):
    _print_aligned({name: EFFECTS[name].law for name in effect_names()})


def _print_aligned(table):
    width = 2 + max(map(len, table))
    for name, text in table.items():
        print(f"{name:{width}s}{text}")


def _prepare(paths, inputs, options):
    """Find out now whether all outputs can be written, and what they need is installed."""
    check_outputs(paths, inputs, force=options.force)
    for path in paths:
        modules, extra = _NEEDED.get(path.suffix.lower(), ((), ""))
        missing = [module for module in modules if importlib.util.find_spec(module) is None]
        if missing:
            raise ImportError(
                f"{path} needs {' and '.join(missing)}. "
                f'Install with: python -m pip install "skhyst[{extra}]"'
            )


def _grid(text):
    return text if text == "auto" else float(text)


def _unit(text):
    column, _, unit = text.rpartition("=")
    if not (column and unit):
        raise ValueError(f"A unit must be given as COLUMN=UNIT. Got {text!r} instead.")
    return column, unit


def _rows(text):
    try:
        start, stop = (int(part) if part else None for part in text.split(":"))
    except ValueError:
        raise ValueError(f"The rows must be given as A:B. Got {text!r} instead.") from None
    return slice(start, stop)


def _training_rows(X, fraction, uneven=False):
    """Return the number of rows of the first part: whole records, or part of the only one.

    Where they may be sampled unevenly, the record level alone tells them apart.
    """
    if not 0.0 < fraction < 1.0:
        raise ValueError(f"The train fraction must lie between 0 and 1. Got {fraction:g} instead.")
    if uneven:
        labels = X.index.get_level_values("record") if X.index.nlevels > 1 else [0] * len(X)
        sizes = list(Counter(labels).values())
    else:
        sizes = [record.n_samples for record in record_slices(X, one_interval=False)]
    single = len(sizes) == 1
    n = int(fraction * len(X)) if single else sum(sizes[: math.ceil(fraction * len(sizes))])
    if not 0 < n < len(X):
        raise ValueError(f"A train fraction of {fraction:g} leaves nothing to hold out.")
    return n
