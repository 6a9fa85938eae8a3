"""Options of the command line for reading a recording, as parameters of `read_records`."""

from ..io import join_files, recognise_columns
from ._messages import as_options

_CELLS = "on_missing", "missing_code", "delimiter", "decimal"
_READING = (  # options that are parameters of read_records
    *("drive", "response", "time", "time_unit", "record", "auxiliary", "sampling_rate"),
    *_CELLS,
)
_KNOWN = tuple(name for name in _READING if name not in ("time_unit", "on_missing", "missing_code"))


def reading_options(options):
    """Return the parameters of read_records."""
    reading = {name: getattr(options, name) for name in _READING}
    if options.join:  # which has read the text
        reading |= {"delimiter": None, "decimal": None}
    reading["units"] = dict(_unit(text) for text in options.unit)
    return reading


def sources(options):
    """Return the recordings: the files, or a single one if the files are joined."""
    if not options.join:
        return options.files
    return [join_files(options.files, delimiter=options.delimiter, decimal=options.decimal)]


def cell_options(options):
    """Return the parameters of read_records on the cells of a file."""
    return {name: getattr(options, name) for name in _CELLS}


def find_columns(path, reading, options, *, ask=False):
    """Add recognised columns to the parameters of read_records, and print them.

    Where the drive and the response may be exchanged, a terminal is asked if ``ask``.
    """
    known = {name: reading[name] for name in _KNOWN}
    columns = recognise_columns(path, **known)
    for role, found in columns.items():
        print(f"{role}: {found.name!r} ({found.reason}); --{role} chooses another")
        reading[role] = found.column
    doubt = columns["drive"].doubt if "drive" in columns else ""
    if doubt:
        print(as_options(doubt, vars(options)))
        if ask and input("Exchange them? [y/N] ").strip().lower() in ("y", "yes"):
            reading["drive"], reading["response"] = reading["response"], reading["drive"]


def _unit(text):
    column, _, unit = text.rpartition("=")
    if not (column and unit):
        raise ValueError(f"A unit must be given as COLUMN=UNIT. Got {text!r} instead.")
    return column, unit
