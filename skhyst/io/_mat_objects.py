"""Objects of MATLAB, which are refused with the line that brings out their numbers.

Their format is not published. The package mat-io (1.0.2) reads tables, but a broken file ends the
interpreter: one in fifty with a few bytes changed.
"""

_EXPORTS = {  # lines of MATLAB after which the numbers of x are in a file that is read
    "timetable": "writetimetable(x, 'x.csv')",
    "table": "writetable(x, 'x.csv')",
    "timeseries": "s = struct('t', x.Time, 'y', x.Data); save('x.mat', '-struct', 's')",
    "iddata": "s = struct('t', x.SamplingInstants, 'u', x.u, 'y', x.y); "
    "save('x.mat', '-struct', 's')",
}


def matlab_object(kind):
    """Return what an object of a class is called, and the line that brings out its numbers."""
    kind = matlab_text(kind) or "object"
    line = _EXPORTS.get(kind, "s = struct(x); save('x.mat', '-struct', 's')")
    return f"a MATLAB {kind} (in MATLAB, where it is called x: {line})"


def matlab_text(value):
    """Return a name that a file holds as bytes or as text."""
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)
