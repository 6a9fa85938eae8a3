"""The command line: argparse over the public interface.

Exit codes: 0 done; 1 the data or the options do not fit together, or a file cannot be read or
written; 2 the call is wrong; 130 interrupted (Ctrl-C); 143 terminated (SIGTERM). Results go to the
standard output, progress and errors to the standard error stream. Nothing here imports a model:
what a command runs is imported when it runs, so that help and usage errors come at once.
"""

import argparse
import importlib
import os
import shlex
import sys
import warnings
from pathlib import Path

from .. import __version__
from ._interruption import ending_on_signals
from ._messages import as_options


def main(argv=None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : list of str, default=None
        Arguments, without the name of the program; None: those of the process.

    Returns
    -------
    int
        Exit code: 0 where all went well.

    Examples
    --------
    ``main(["diagnose", "recording.csv"])`` is ``skhyst diagnose recording.csv``.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    parser = _parser()
    if "_ARGCOMPLETE" in os.environ:  # a shell asks for completions
        importlib.import_module("argcomplete").autocomplete(parser)
    options = parser.parse_args([_as_number(text) for text in argv])
    options.command = shlex.join(["skhyst", *argv])
    try:
        with warnings.catch_warnings(), ending_on_signals():
            warnings.showwarning = lambda message, *more, **named: _tell(message, vars(options))
            options.run(options)
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has ended, as in `skhyst models | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt as ended:
        print(f"skhyst: {ended or 'interrupted'}", file=sys.stderr)
        return getattr(ended, "code", 130)
    except (ValueError, TypeError, OSError, ImportError, NotImplementedError) as error:
        _tell(error, vars(options))
        return 1
    return 0


def _tell(message, known):
    print(f"skhyst: {as_options(str(message), known)}", file=sys.stderr)


def _parser():
    parser = argparse.ArgumentParser(
        prog="skhyst",
        description="Find the physical effect that a declared model lacks; put models to use.",
    )
    parser.add_argument("--version", action="version", version=f"skhyst {__version__}")
    commands = parser.add_subparsers(dest="subcommand", required=True, metavar="command")
    _add_inspect(commands)
    _add_diagnose(commands)
    _add_next(commands)
    _add_compensate(commands)
    _add_export(commands)
    demo = commands.add_parser("demo", help="hide an effect in a simulated actuator, then find it")
    add = demo.add_argument
    add("--output", type=Path, default=Path("skhyst_demo"), help="folder for the files")
    add("--seed", type=int, default=0, help="chooses the actuator and the effect")
    add("--jobs", type=int, default=-1, help="processes (default: all processors)")
    add("--quiet", action="store_true", help="no progress")
    demo.set_defaults(run=_later("_demo", "demo"))
    for name, command in commands.choices.items():
        more = ", and a drive that misses the reference" if name == "compensate" else ""
        about = f"write over files that are there{more}"
        command.add_argument("--force", action="store_true", help=about)
    _add_app(commands)
    for name, listed in (
        ("models", "models that can be declared"),
        ("effects", "effects that a search tries"),
    ):
        commands.add_parser(name, help=f"list the {listed}").set_defaults(
            run=_later("_list", f"list_{name}")
        )
    return parser


def _add_app(commands):
    parser = commands.add_parser("app", help="do all of it in the browser, on this machine")
    parser.add_argument("--port", type=int, default=8501, help="(default: 8501)")
    parser.add_argument("--no-browser", action="store_true", help="serve, and open no browser")
    parser.set_defaults(run=_later("_app", "app"))


def _later(module, name):
    """Return a function that is imported when it is called."""

    def run(options):
        getattr(importlib.import_module(f".{module}", __package__), name)(options)

    return run


def _add_inspect(commands):
    parser = commands.add_parser(
        "inspect", help="show the columns, records and faults of recordings"
    )
    _add_reading(parser, nargs="+")
    drawn = "draw the signals and the loop of one recording, .png, .svg or .pdf"
    parser.add_argument("--picture", type=Path, metavar="FILE", help=drawn)
    parser.set_defaults(run=_later("_inspect", "inspect"))


def _add_diagnose(commands):
    parser = commands.add_parser("diagnose", help="search recordings for missing effects")
    _add_search(parser, nargs="+")
    table = "one row per recording, .parquet or .csv; resumes where it was stopped"
    parser.add_argument("--summary", type=Path, metavar="FILE", help=table)
    parser.set_defaults(run=_later("_diagnose", "diagnose"))


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
    parser.set_defaults(run=_later("_diagnose", "propose"))


def _add_reading(parser, nargs=1):
    """Add the recordings, and the options of reading them."""
    add = parser.add_argument
    known = (
        "csv, txt, lvm, asc, xlsx, mat, npy, npz, json, jsonl, hdf5, parquet, feather, tdms, wav"
    )
    add("files", type=Path, nargs=nargs, metavar="file", help=f"recording: {known}")
    one = "the files hold columns of one recording, side by side"
    add("--join", action="store_true", help=one)
    found = "(default: recognised by its name and values, if possible)"
    add("--drive", metavar="COL", help=f"column or variable of the drive {found}")
    add("--response", metavar="COL", help="column or variable of the response (likewise)")
    add("--time", metavar="COL", help="column of the time (likewise)")
    unit = "unit of a column if the file does not give it; repeatable"
    add("--unit", metavar="COL=UNIT", action="append", default=[], help=unit)
    add("--record", metavar="COL", help="column that labels the records (likewise)")
    add("--auxiliary", metavar="COL", action="append", default=[], help="further input; repeatable")
    _add_layout(parser)


def _add_layout(parser):
    """Add the options of reading any file of signals."""
    add = parser.add_argument
    add("--time-unit", help="unit of the time (default: that given in the file, else s)")
    add("--sampling-rate", type=float, metavar="HZ", help="instead of --time")
    _add_cells(parser)


def _add_cells(parser):
    """Add the options of reading the cells of a file."""
    add = parser.add_argument
    lost = "value that marks a missing reading; nan: there is none"
    add("--missing-code", type=float, metavar="VALUE", help=lost)
    add("--on-missing", choices=("raise", "drop", "interpolate"), default="raise")
    add("--delimiter", metavar="CHAR", help="of delimited text, if it is not detected")
    add("--decimal", choices=(".", ","), help="decimal sign of text, if it is not detected")


def _add_grid(parser):
    grid = "interpolate unevenly sampled records onto even grids, of their own or of S s"
    parser.add_argument("--resample", type=_grid, metavar="auto|S", help=grid)


def _add_search(parser, nargs=1):
    _add_reading(parser, nargs)
    add = parser.add_argument
    loop = "column of the reference, if the drive came from a feedback controller"
    add("--reference", metavar="COL", help=loop)
    add("--rows", metavar="A:B", help="use these rows of the file only, counted from 0")
    _add_grid(parser)
    rest = "search the first fraction F (of the records, or of the only one), report on the rest"
    add("--train-fraction", type=float, metavar="F", help=rest)
    series = "declared model, in series with +: prandtl_ishlinskii+transfer_function(n_poles=2)"
    add("--model", metavar="NAME", help=f"{series} (default: the best of a few that are compared)")
    add("--effects", default="all", help="comma-separated names (default: all)")
    add("--folds", "--cv", type=int, default=5, metavar="N", help="folds (default: 5)")
    add("--washout", type=int, metavar="N", help="samples at the start that do not count")
    gross = "huber: gross errors of the measurement have less weight (default: squared)"
    add("--loss", choices=("squared", "huber"), default="squared", help=gross)
    add("--alpha", type=float, default=0.01, help="probability of a false claim (default: 0.01)")
    add("--max-effects", type=int, default=3, help="largest number of claims (default: 3)")
    nameless = "seek a term without a name where no effect explains the residual (default: yes)"
    add("--unknown", action=argparse.BooleanOptionalAction, default=True, help=nameless)
    add("--seed", type=int, default=0, help="seed (default: 0)")
    add("--jobs", type=int, default=-1, help="processes (default: all processors)")
    add("--report", type=Path, metavar="FILE", help="report, .html or .md")
    add("--save", type=Path, metavar="FILE", help="augmented model, .skops or .joblib")
    add("--json", type=Path, metavar="FILE", help="results as JSON")
    kept = "state of the search after each claim; the same command resumes from it"
    add("--checkpoint", type=Path, metavar="FILE", help=kept)
    add("--quiet", action="store_true", help="no progress")


def _add_model(parser):
    add = parser.add_argument
    add("model", type=Path, help="fitted model, .skops; others with --trust")
    trust = "load a pickle, or types that skops does not know: they can run any code"
    add("--trust", action="store_true", help=trust)


def _add_compensate(commands):
    about = "the drive under which a fitted model follows a reference"
    parser = commands.add_parser("compensate", help=about)
    _add_model(parser)
    add = parser.add_argument
    add("file", type=Path, help="reference: csv or another format that diagnose reads")
    add("-o", "--output", type=Path, required=True, metavar="FILE", help="time and drive, csv")
    add("--time", metavar="COL", help="column of the time (default: the first but the records)")
    add("--record", metavar="COL", help="column that labels the records (default: by its name)")
    column = "column of the reference (default: the next)"
    add("--reference", metavar="COL", help=column)
    _add_layout(parser)
    _add_grid(parser)
    limits = "of the drive, in its units (default: those in the fit of the model)"
    add("--limits", type=float, nargs=2, metavar=("LOW", "HIGH"), help=limits)
    rate = "fastest change of the drive, its units per s (default: that in the fit)"
    add("--rate-limit", type=float, metavar="RATE", help=rate)
    rest = (
        "drive at which the amplifier rests, from and to which ramps are written (default: the one"
    )
    add("--rest", type=float, metavar="DRIVE", help=f"{rest} nearest to 0 within that written)")
    margin = "fraction of range and rate of the fit by which its limits are widened (default: 0)"
    add("--limit-margin", type=float, default=0.0, metavar="PART", help=margin)
    add("--no-limits", action="store_true", help="no limits but those that are given")
    missed = "largest error allowed, as a fraction of the reference's range (default: 0.05)"
    add("--max-residual", type=float, default=0.05, metavar="PART", help=missed)
    faster = "cut-off frequency of a low-pass of the reference"
    add("--bandwidth", type=float, metavar="HZ", help=faster)
    parser.set_defaults(run=_later("_compensate", "compensate"))


def _add_export(commands):
    about = "a fitted model, compensator or controller as C, Structured Text or an FMU"
    parser = commands.add_parser("export", help=about)
    _add_model(parser)
    add = parser.add_argument
    to = parser.add_mutually_exclusive_group(required=True)
    to.add_argument("--c", type=Path, metavar="DIR", help="folder for the C files")
    to.add_argument("--st", type=Path, metavar="DIR", help="folder for Structured Text of a PLC")
    unit = "functional mock-up unit, with the name of the file"
    to.add_argument("--fmu", type=Path, metavar="FILE.fmu", help=unit)
    add("--dt", type=float, metavar="S", help="sampling interval (default: that of the fit)")
    add("--initial-state", choices=("rest", "zero"), help="(default: that of the model)")
    add("--u0", type=float, default=0.0, help="input at which the device rests (default: 0)")
    units = "name of its unit; for int32 the value that the integer 1 stands for"
    add("--input-unit", metavar="UNIT", help=units)
    add("--output-unit", metavar="UNIT", help=units)
    for_c = parser.add_argument_group("for --c and --st")
    add = for_c.add_argument
    add("--name", help="name of files and functions (default: that of the model's file)")
    add("--dtype", choices=("float64", "float32", "int32"), help="(default: float64)")
    add("--form", choices=("table", "step"), help="laws by tables or integrated (default: table)")
    sizes = "C alone: flash, RAM, stack and instructions on Cortex-M0, Cortex-M4F, AVR and x86-64"
    add("--sizes", action="store_const", const=True, help=sizes)
    simulink = "C alone: an S-function of Simulink, too"
    add("--simulink", action="store_const", const=True, help=simulink)
    add("--drive", type=Path, metavar="FILE", help="input of the test program; int32 needs it")
    column = "column of the drive (default: the second); repeat it for a model of several inputs"
    add("--column", action="append", metavar="COL", help=column)
    _add_cells(parser)
    for_fmu = parser.add_argument_group("for --fmu")
    for_fmu.add_argument("--fmi-version", choices=("2.0", "3.0"), help="(default: 3.0)")
    parser.set_defaults(run=_later("_export", "export"))


def _as_number(text):
    """Return a negative number such as -1e-9 with a space in front, others as they are.

    Without it argparse takes it for an option, unless it is written as -1 or -0.5.
    """
    try:
        is_number = text[:2] != "--" and text[:1] == "-" and bool(float(text))
    except ValueError:
        return text
    return f" {text}" if is_number and not text[1:].replace(".", "", 1).isdigit() else text


def _grid(text):
    return text if text == "auto" else float(text)
