"""MATLAB objects, which are refused with a line of MATLAB that exports their numbers.

Their format is not published. The package mat-io (1.0.2) reads tables, but broken files crash the
interpreter: one in fifty of those with a few bytes changed.
"""

_EXPORTS = {  # lines of MATLAB that write the numbers of x to a file that can be read
    "timetable": "writetimetable(x, 'x.csv')",
    "table": "writetable(x, 'x.csv')",
    "timeseries": "s = struct('t', x.Time, 'y', x.Data); save('x.mat', '-struct', 's')",
    "iddata": "s = struct('t', x.SamplingInstants, 'u', x.u, 'y', x.y); "
    "save('x.mat', '-struct', 's')",
}


def matlab_object(kind):
    """Return the name of a MATLAB class, and the line of MATLAB that exports an object of it."""
    kind = matlab_text(kind) or "object"
    line = _EXPORTS.get(kind, "s = struct(x); save('x.mat', '-struct', 's')")
    return f"a MATLAB {kind} (in MATLAB, where it is called x: {line})"


def matlab_text(value):
    """Return a name, stored as bytes or as text, as text."""
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)
