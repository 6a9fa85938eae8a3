"""`skhyst diagnose` and `skhyst next`: search recordings, print the result, write the files."""

import importlib.util
import math
import shlex
import sys
from collections import Counter
from concurrent.futures import BrokenExecutor

from .._files import check_outputs
from .._validation import refuse_still
from ..diagnosis import EffectSearchCV, Report, next_experiment
from ..discovery import parse_model
from ..exceptions import RecordError
from ..fleet import diagnose_files
from ..inspection import FAR, compare_models
from ..persistence import save_model
from ..records import read_records, record_slices, resample_records
from ._reading_options import find_columns, reading_options, sources

_DRAWN = ("jinja2", "matplotlib")
_REPORTS = {".html": _DRAWN, ".htm": _DRAWN, ".md": ("jinja2",)}
_NEEDED = {suffix: (modules, "plot") for suffix, modules in _REPORTS.items()}
_NEEDED[".skops"] = (("skops",), "io")  # by suffix: modules needed, and the extra with them
_OF_ONE = (
    "rows",
    "train_fraction",
    "report",
    "save",
    "json",
    "checkpoint",
    "join",
)  # options of a single recording


def diagnose(options):
    """Search one recording, or many for a table."""
    if options.summary:
        return _summarize(options)
    if len(options.files) > 1 and not options.join:
        raise ValueError(
            "Several recordings give one table: add --summary FILE. Several files with columns of "
            "one recording are joined: add --join."
        )
    return _diagnose_one(options)


def _diagnose_one(options):
    """Search one recording, print the result, and return the search."""
    outputs = [options.report, options.save, options.json, getattr(options, "output", None)]
    if options.report and options.report.suffix.lower() not in _REPORTS:
        raise ValueError(f"The report must end in .html or .md. Got {options.report} instead.")
    model = parse_model(options.model) if options.model else None  # refused before it is read
    checkpoint = [options.checkpoint] if options.checkpoint else []
    prepare([path for path in outputs if path], [*options.files, *checkpoint], options)
    check_outputs(checkpoint, options.files, force=True)  # the search refuses one of another search
    recordings = sources(options)
    X, y = read_records(recordings[0], **_reading(options, recordings))
    if options.rows:
        rows = _rows(options.rows)
        X, y = X.iloc[rows], y.iloc[rows]
    refuse_still(X.iloc[:, 0].to_numpy())
    held_out = None
    if options.train_fraction is not None:
        n = _training_rows(X, options.train_fraction, uneven=options.resample is not None)
        X, y, held_out = X.iloc[:n], y.iloc[:n], (X.iloc[n:], y.iloc[n:])
    comparison = None
    if model is None:
        model, comparison = _choose(options, X, y)
    search = make_search(model, options, **_searching(options)).fit(X, y)
    if comparison is None and _may_have_better_model(search):
        comparison = _compared(options, X, y)
    conclude(search, options, held_out, comparison)
    return search


def _choose(options, X, y):
    """Compare models, and return the one to declare and the comparison; a terminal may choose."""
    comparison = _compared(options, X, y)
    print(comparison)
    name, model = comparison.taken, parse_model(comparison.taken)
    if _asks(options):
        print(f"What moves? The drive is {X.columns[0]!r}, the response is {y.name!r}.")
        while answer := input(f"Model to declare (Enter: {name}): ").strip():
            try:
                name, model = answer, parse_model(answer)
                break
            except ValueError as error:
                print(error)
    options.command += f" --model {shlex.quote(name)}"
    return model, comparison


def _asks(options):
    """Whether a person at a terminal can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty() and not options.quiet


def _compared(options, X, y):
    if options.resample is not None:
        X, y = resample_records(X, y, dt=options.resample)
    return compare_models(X, y, verbose=int(not options.quiet))


def _may_have_better_model(search):
    """Whether another model can be so much better than the declared one that a report says so."""
    left = search.error_after_ > (1.0 + search.min_improvement) * search.noise_floor_
    return left and search.error_before_ > FAR * search.noise_floor_


def _summarize(options):
    """Search many recordings, and write one row for each."""
    refused = [name for name in _OF_ONE if getattr(options, name)]
    if refused:
        raise ValueError(f"--{refused[0].replace('_', '-')} is for one recording: not --summary.")
    reading, more = _reading(options, options.files), _searching(options)
    model = parse_model(options.model) if options.model else _of_first(options, reading)
    search = make_search(model, options, **more)
    search.set_params(n_jobs=1, verbose=0, unknown=False)  # a table has no place for it
    try:
        table = diagnose_files(
            options.files,
            search,
            reading=reading,
            summary=options.summary,
            force=options.force,
            n_jobs=options.jobs,
            on_done=None if options.quiet else _print_rows,
        )
    except BrokenExecutor as error:
        raise OSError(
            f"A worker process has died. {options.summary} has the results so far: the same "
            "command resumes from there, with fewer --jobs if memory ran out."
        ) from error
    found = table[table["file"].isin([str(file) for file in options.files])]
    failed = int(found["failure"].astype(bool).sum())
    print(f"{len(found)} recordings: {failed} could not be searched")
    effects = Counter(name for names in found["effects"] for name in names.split(", ") if name)
    for effect, number in effects.most_common():
        print(f"  {effect}: {number}")
    print(f"written: {options.summary}")


def _of_first(options, reading):
    """Return the model that the first recording that can be read asks for, to search all with."""
    failure = None
    for path in options.files:
        try:
            comparison = _compared(options, *read_records(path, **reading))
        except (ValueError, OSError) as error:
            failure = failure or error
            continue
        print(f"{path}: {comparison}")
        return parse_model(comparison.taken)
    raise failure


def _print_rows(rows):
    for row in rows.itertuples():
        print(f"{row.file}: {row.failure or row.effects or 'nothing missing'}", file=sys.stderr)


def _reading(options, recordings):
    """Return the parameters of read_records, with the columns that no option names.

    These are the columns recognised in the first file where that is possible. In a table, files
    that cannot be read get a row with the failure, so they are no error here.
    """
    reading = reading_options(options)
    if options.reference is not None:
        reading["auxiliary"] = [*options.auxiliary, options.reference]
    for path in recordings:
        try:
            find_columns(path, reading, options, ask=_asks(options))
            break
        except (RecordError, OSError) as error:
            failure = error
    else:
        if None in (options.drive, options.response) or len(recordings) == 1:
            raise failure
    return reading


def _searching(options):
    """Return the parameters of the search."""
    effects = options.effects if options.effects == "all" else options.effects.split(",")
    names = ("alpha", "max_effects", "resample", "washout", "loss", "unknown", "checkpoint")
    more = {name: getattr(options, name) for name in names}
    more |= {"effects": effects, "cv": options.folds, "reference": None}
    if options.reference is not None:  # the last column: drive and auxiliary inputs come before
        more["reference"] = 1 + len(options.auxiliary)
    return more


def propose(options):
    """Search one recording, and write the drive to record next."""
    if not options.limits[0] < options.limits[1]:
        raise ValueError(f"The limits must be LOW HIGH. Got {options.limits} instead.")
    search = _diagnose_one(options)
    asked = options.limits, options.rate, options.duration, options.dt
    experiment = next_experiment(search, *asked)
    experiment.save(options.output, force=options.force)
    print(f"record next: {experiment.reason}")
    print(f"written: {options.output}")


def make_search(model, options, **more):
    """Return a search with the options that all commands with a search have."""
    quiet = {"n_jobs": options.jobs, "verbose": int(not options.quiet)}
    return EffectSearchCV(model, random_state=options.seed, **quiet, **more)


def conclude(search, options, held_out, comparison=None):
    """Print the result and write the files."""
    more = {"held_out": held_out, "comparison": comparison}
    report = Report.from_search(search, command=options.command, **more)
    print(report.to_text(), end="")
    if search.units_.time == "sample":
        print("sampling interval unknown: give --time or --sampling-rate for s and Hz")
    _write(search, report, options)


def _write(search, report, options):
    """Write the files; if one fails, the others are still written."""
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
                check_outputs([path], force=options.force)  # again, after a long search
                write(path)
            except OSError as error:
                failures.append(str(error))
            except TypeError as error:  # skops cannot write the model
                failures.append(f"{path} cannot be written: {error}")
            else:
                print(f"written: {path}")
    if failures:
        raise OSError(" ".join(failures))


def prepare(paths, inputs, options):
    """Check before a search that all outputs can be written and the modules are installed."""
    check_outputs(paths, inputs, force=options.force)
    for path in paths:
        modules, extra = _NEEDED.get(path.suffix.lower(), ((), ""))
        missing = [module for module in modules if importlib.util.find_spec(module) is None]
        if missing:
            raise ImportError(
                f"{path} needs {' and '.join(missing)}. "
                f'Install with: python -m pip install "skhyst[{extra}]"'
            )


def _rows(text):
    try:
        start, stop = (int(part) if part else None for part in text.split(":"))
    except ValueError:
        raise ValueError(f"The rows must be given as A:B. Got {text!r} instead.") from None
    return slice(start, stop)


def _training_rows(X, fraction, uneven=False):
    """Return the number of rows of the first part: complete records, or a fraction of a single one.

    Records that may be sampled unevenly are distinguished by the record level only.
    """
    if not 0.0 < fraction < 1.0:
        raise ValueError(f"The train fraction must lie between 0 and 1. Got {fraction:g} instead.")
    if uneven:
        labels = X.index.get_level_values("record") if X.index.nlevels > 1 else [0] * len(X)
        sizes = list(Counter(labels).values())
    else:
        slices = record_slices(X, one_interval=False, bridge=True)
        sizes = [record.n_samples for record in slices]
    single = len(sizes) == 1
    n = int(fraction * len(X)) if single else sum(sizes[: math.ceil(fraction * len(sizes))])
    if not 0 < n < len(X):
        raise ValueError(f"A train fraction of {fraction:g} leaves nothing to hold out.")
    return n
