"""Recognition of the columns of a recording: drive, response, time and record.

The role of a column follows from the words of its name, else from its unit: `drive`, `input`,
`command` have precedence over `voltage`, and that over `V`. A name whose words contradict each
other gives no role. A time column must increase; without a name that shows it, a column is the time
if it is the only one that increases by equal steps. The only remaining column that is not constant
takes the remaining role. If two columns may have a role, none is chosen: a wrong guess would be
worse than a question. Words that all signals share say nothing, nor do `in` and `out` where one
names the port of an instrument (`sensor in`, `DAC out`). Of axes that are recorded at once
(u1, y1, u2, y2), a given column selects the axis. A force and a motion may each be the cause of the
other: the force is taken, and that it may be the other way round is said.
"""

import re
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ._clock import JITTER, are_same_times, by_record, record_labels
from ._column_names import TIME, time_unit_of, unit_of, without_unit
from ._file_columns import (
    as_columns,
    listed_variables,
    load_column,
    long_columns,
    numbers,
    place_of,
    record_groups,
)
from ._formats import opened

ROLES = ("drive", "response", "time", "record")
_ALONE = {"drive": {"drive", "input", "u"}, "response": {"response", "output", "y"}}
_WORDS = (  # words for the role of a column, and for its quantity; the former have priority
    {
        "drive": "drive|driving|input|in|u|command|commanded|cmd|excitation|stimulus|ao|dac"
        "|stellgröße|eingang|entrée|commande|entrada|ingresso",
        "response": "response|output|out|y|measured|meas|actual|act|sensor|sensed|feedback|fbk"
        "|readout|ai|adc|istwert|ausgang|sortie|mesure|salida|uscita",
    },
    {
        "drive": "voltage|volts?|current|spannung|strom|courant|voltaje|tensione|corriente"
        "|corrente|电压|电流|電圧|電流|flow|inflow|zufluss|durchfluss",
        "response": "position|pos|displacement|disp|stroke|path|deflection|deformation|extension"
        "|elongation|strain|angle|rotation|gauge|encoder|interferometer|lvdt|x|z|weg|déplacement"
        "|posici[oó]n|desplazamiento|posizione|spostamento|位移|変位|位置|level|pegel|füllstand",
    },
)
_PORTS = {"in", "out"}  # of the device, or of the instrument on the other side
_UNITS = {"drive": "[mk]?V|m?A|[kM]?A/m|k?Oe", "response": "[munpµμ]?m|[muµμ]?rad|deg|°|[muµμ]?T"}
_FORCE = "forces?|load|torque|kraft|drehmoment|fuerza|forza|couple"
_FORCES = "[munpµμkM]?N([·* ]?m)?|kgf|lbf"
_MOTIONS = "[munpµμck]?m(/s)?|[muµμ]?rad(/s)?|deg|°|in"
_CHANNEL = "A"  # or a phase: without brackets no unit
_LAST = {  # role of a column if no other role is left for it
    "drive": "reference|ref|target|setpoint|desired|soll|sollwert|consigne",
    "response": "velocity|vel|speed|acceleration|acc|temperature?|temp|humidity",
}
_NEITHER = "|".join(  # signals of a controller, of the environment, and counters
    (*_LAST.values(), "error|err|status|flag|mode|index|samples?|number|count|counter|ticks?|id")
)
_AT_PRESENT = re.compile(r"current(?=[ _]?(position|value|angle))", re.IGNORECASE)
_CLOCK = re.compile(r"(\d+[./-]\d+[./-]\d+(T| +))?\d+:\d\d(:\d\d([.,]\d+)?)?Z?( [AP]M)?")
_DATE = re.compile(r"\d+([./-])\d+\1\d+")
_AXIS = (re.compile(r"\d+"), re.compile(r"(?<![^\W_])[xyz](?![^\W_])", re.IGNORECASE))
_RECORD = "record|run|recording|trial|segment"
_MOST_RESTARTS = 0.1  # largest fraction of rows at which time restarts or a record label changes
_SHOWN = 20  # candidates that an error message lists
_JOIN = "Columns in several files are joined by join_files (--join on the command line)."
_NAMED, _LEFT = "by its name", "the only other column that moves"
_ALLOWED = "the only one left that its name allows"


@dataclass(frozen=True)
class RecognisedColumn:
    """A column with a role: its address, its name, and why it has the role.

    Parameters
    ----------
    column : str or int
        Name or position, as :func:`~skhyst.records.read_records` takes it.
    name : str
        Name with its unit.
    reason : str
        Why the column has the role.
    doubt : str, default=""
        What to do where another column is meant, if that is as likely: a force may be the cause of
        a motion, or its answer.

    See Also
    --------
    recognise_columns : Find these columns.
    """

    column: str | int
    name: str
    reason: str
    doubt: str = ""


def recognise_columns(
    path,
    *,
    drive=None,
    response=None,
    time=None,
    record=None,
    auxiliary=(),
    sampling_rate=None,
    delimiter=None,
    decimal=None,
):
    """Find the columns of a recording by their names, units and values.

    Parameters
    ----------
    path : str, Path, or pandas or polars DataFrame
        Recording, as :func:`~skhyst.records.read_records` reads it.
    drive, response, time, record : str or int, optional
        Columns whose role is known; they are not looked for.
    auxiliary : sequence of str or int, default=()
        Columns that are auxiliary inputs.
    sampling_rate : float, optional
        In Hz; if it is given, no time column is looked for.
    delimiter, decimal : str, optional
        As in :func:`~skhyst.records.read_records`.

    Returns
    -------
    dict of str to RecognisedColumn
        Roles that were not given: ``"drive"`` and ``"response"``; ``"time"`` and ``"record"`` if
        the file has them.

    Raises
    ------
    RecordError
        If the file cannot be read, or no column or more than one may be the drive, the response or
        the time.

    See Also
    --------
    skhyst.records.read_records : Read the columns that are found.
    skhyst.records.inspect_recording : An overview that also lists what is unclear.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.io import recognise_columns
    >>> table = pd.DataFrame({"time_ms": [0.0, 1.0, 2.0], "U [V]": [0, 1, 2], "sg [um]": [0, 3, 5]})
    >>> {role: found.name for role, found in recognise_columns(table).items()}
    {'time': 'time_ms', 'drive': 'U [V]', 'response': 'sg [um]'}
    """
    path, variables = opened(path, delimiter=delimiter, decimal=decimal)
    roles = {"drive": drive, "response": response, "time": time, "record": record}
    return find_roles(
        path, variables, roles, as_columns(auxiliary), timed=sampling_rate is not None
    )


def are_swapped(drive, response) -> bool:
    """Whether the names of a drive and a response say that each is the other."""
    roles = [
        _Candidate(None, None, SimpleNamespace(name=str(n))).kinds[0] for n in (drive, response)
    ]
    return roles == [{"response"}, {"drive"}]


def find_roles(path, variables, roles, others=(), *, timed):
    """Return a dict of a RecognisedColumn for each role without a given column.

    One error lists all roles that are not determined.
    """
    found, questions = roles_and_questions(path, variables, roles, others, timed=timed)
    if questions:
        raise RecordError(" ".join(questions))
    return found


def roles_and_questions(path, variables, roles, others=(), *, timed):
    """Return the result of `find_roles`, and a question for each role that was not found."""
    given = [column for column in (*roles.values(), *others) if column is not None]
    group = next(iter(record_groups(variables, given).values()))
    places = long_columns(group)
    known = [place_of(path, group, places, column) for column in given]
    columns = [_Candidate(path, group, place) for place in places]
    free = [c for c in columns if c.place not in known]
    mark, axes = _axes([c for c in columns if c.varies and not c.called_time])
    said = [{*c.words} for c in columns if c.varies and not c.called_time]
    silent = set.intersection(*said) if len(said) > 1 else set()
    silent |= _PORTS if any(map(_names_a_port, said)) else set()
    for c in columns:
        c.words = [w for w in c.words if w not in silent and not (axes and mark.fullmatch(w))]
    found, candidates, missing = {}, {}, [role for role in ROLES if roles[role] is None]
    if "time" in missing and not timed:
        found["time"], candidates["time"] = _time(free)
    if "record" in missing:
        labels = [c for c in free if re.fullmatch(_RECORD, c.name.lower()) and c.changes_seldom]
        found["record"] = (labels[0], _NAMED) if len(labels) == 1 else None
    found = {role: choice for role, choice in found.items() if choice}
    used = [column for column, _ in found.values()]
    times = [found["time"][0].stored] if "time" in found else []
    # a second copy of the time is no signal, unless it has the unit of one: a ramp
    signals = [
        c
        for c in free
        if not any(c is column for column in used)
        and (c.unit_role or not any(np.array_equal(c.stored, time) for time in times))
    ]
    asked = [role for role in ("drive", "response") if role in missing]
    if len(asked) == 1:  # the other gives the axis
        own = load_column(path, group, roles[({"drive", "response"} - {*asked}).pop()]).name
        own = next((axis for axis in axes if own in axis), ())
        signals = [c for c in signals if c.name in own] or signals
    for role in asked:
        found[role], candidates[role] = _named(role, signals, len(asked))
    # after all named roles: what they leave over is then unique more often
    for role in asked:
        if found[role] is None and not candidates[role]:
            found[role], candidates[role] = _left_over(role, signals, found)
            if found[role] is None:
                candidates.setdefault(role, [])
    open_ = [role for role in asked if not found[role]]
    left = {c.place: c.name for role in open_ for c in candidates[role]}
    too_few = len(open_) == 2 and len(left) < 2
    if too_few:
        for role in open_:
            del candidates[role], found[role]
    questions = [
        _question(path, group, role, candidates[role])
        for role in candidates
        if role not in found or found[role] is None
        if role != "time" or candidates["time"]
    ]
    pair = [found[role][0].place.position for role in asked if found.get(role)]
    pair += [roles[role] for role in ("drive", "response") if roles[role] is not None]
    if separate := separate_times(path, group, [*pair, *others]):
        questions = [separate]
    columns = {
        role: RecognisedColumn(choice[0].place.address, choice[0].name, choice[1])
        for role, choice in found.items()
        if choice
    }
    if _either_causes(found):
        columns["drive"] = replace(columns["drive"], doubt=_doubt(columns))
    if too_few:
        questions.append(
            f"In {path.name} {next(iter(left.values()))!r} is the only signal: a drive and a "
            f"response are needed. {_JOIN}"
            if left
            else f"In {path.name} no column is a signal. {listed_variables(group)}"
        )
    if len(open_) == 2 and axes:
        listed = "; ".join(", ".join(map(repr, axis)) for axis in axes[:_SHOWN])
        questions.append(
            f"These are {len(axes)} axes that are recorded at once ({listed}): the drive of one "
            "gives its response."
        )
    if questions and columns:
        known = ", ".join(f"{role} {column.name!r}" for role, column in columns.items())
        questions.append(f"Recognised: {known}.")
    return columns, questions


def separate_times(path, variables, signals):
    """Return what to do if signals have times of their own that differ, "" if they have not.

    The time of a signal is the last one before it, or the first one if none is before any signal.
    """
    columns = [_Candidate(path, variables, place) for place in long_columns(variables)]
    times = [c for c in columns if c.called_time and c.rises]
    if len(times) < 2:
        return ""
    names = {load_column(path, variables, signal).name for signal in signals}
    signals = [c for c in columns if {c.name, c.place.full_name} & names]
    before = any(t.place.position < c.place.position for c in signals[:1] for t in times)
    own = []
    for c in signals:
        apart = [(c.place.position - t.place.position) * (1 if before else -1) for t in times]
        nearest = [k for k in np.argsort(apart) if apart[k] > 0]
        own += [(c, times[nearest[0]])] if nearest else []
    for (one, its), (other, others) in pairwise(own):
        if its is not others and not are_same_times(path, its.column, others.column):
            return (
                f"In {path.name} {one.name!r} and {other.name!r} have times of their own that "
                f"differ, the columns {its.place.position} ({its.name!r}) and "
                f"{others.place.position} ({others.name!r}): a row is not one instant. Write both "
                f"on one time, as by numpy.interp(time of {one.name!r}, time of {other.name!r}, "
                f"{other.name!r}), with that time as the only one."
            )
    return ""


def days(path, variables, clock):
    """Return a number for each row that rises where a date changes although the clock goes on.

    The clock of a new day, or of 12 hours, begins a half day anew.
    """
    half_days = np.floor(clock / pd.Timedelta(hours=12))
    jumps = np.zeros(len(clock), dtype=bool)
    for c in (_Candidate(path, variables, place) for place in long_columns(variables)):
        dated = c.stored.dtype.kind == "M" or _DATE.fullmatch(str(c.stored[0]))
        if dated and len(c.stored) == len(clock) and c.changes_seldom:
            jumps[1:] |= (c.stored[1:] != c.stored[:-1]) & (half_days[1:] == half_days[:-1])
    return np.cumsum(jumps)


def interleaved(path, variables, time):
    """Return what to do if runs alternate in the rows, as the times of the rows show, else "".

    Then the time rises within each of a column's few values, to which the rows return.
    """
    time = np.asarray(time)
    if np.all(time[1:] > time[:-1]):
        return ""
    for c in (_Candidate(path, variables, place) for place in long_columns(variables)):
        labels = record_labels(c.stored)
        if len(labels) != len(time) or np.asarray(labels).dtype.kind == "f":
            continue
        rows, values = pd.factorize(labels)
        if (
            1 < len(values) <= _MOST_RESTARTS * len(rows)
            and np.count_nonzero(np.diff(rows)) >= len(values)
            and by_record(labels, time) is not None
        ):
            return (
                f"The rows of {path.name} alternate between the {len(values)} values of "
                f"{c.name!r}, and the time rises within each: pass record={c.name!r} with the time "
                "if they are records."
            )
    return ""


class _Candidate:
    """A column that may have a role; it is loaded when its values are needed."""

    def __init__(self, path, variables, place):
        self.path, self.variables, self.place, self.name = path, variables, place, place.name

    @cached_property
    def words(self):
        """Words of the name in lower case, without digits."""
        name = _AT_PRESENT.sub("", without_unit(self.name))
        parts = re.findall(r"[A-ZÄÖÜ]?[^\W\d_A-ZÄÖÜ]+|[A-ZÄÖÜ]+", name)
        return [part.lower() for part in parts]

    @cached_property
    def unit(self):
        """Unit in brackets, or a possible unit at the end of the name, where A may be a channel."""
        return unit_of(self.name) or re.split(r"[\s_/]", self.name)[-1].removesuffix(_CHANNEL)

    def has(self, words):
        """Whether one of the words is in the name."""
        return any(re.fullmatch(words, word) for word in self.words)

    @cached_property
    def values(self):
        """Values as floats, None if they are not numbers."""
        try:
            return numbers(self.path, self.name, self.stored)
        except RecordError:
            return None

    @cached_property
    def column(self):
        """The column as it is loaded."""
        return load_column(self.path, self.variables, self.place.position)

    @property
    def stored(self):
        """Values as they are stored."""
        return self.column.values

    @cached_property
    def unit_role(self):
        """Role by the unit, as a set of one or none."""
        return {role for role, units in _UNITS.items() if re.fullmatch(units, self.unit)}

    @cached_property
    def kinds(self):
        """Roles by the words for a role, by those for a quantity, and by the unit."""
        named = [{role for role, words in level.items() if self.has(words)} for level in _WORDS]
        return [*named, self.unit_role]

    @cached_property
    def role(self):
        """Role by name and unit: drive, response, either or neither; "" if these do not show it."""
        return "neither" if self.counts else self.named_role

    @cached_property
    def named_role(self):
        """Role by name and unit, whatever the values."""
        if self.has(_NEITHER):
            return "neither"
        first = next((kind for kind in self.kinds if kind), {""})
        return next(iter(first)) if len(first) == 1 else "either"

    @property
    def is_force(self):
        """Whether it is a force or a torque that is not called a drive."""
        return not self.kinds[0] and (self.has(_FORCE) or bool(re.fullmatch(_FORCES, self.unit)))

    @cached_property
    def rises(self):
        """Whether it increases from row to row, except at a few restarts."""
        if self.values is None:
            return self.stored.dtype.kind in "Mm" or bool(
                re.match(r"\d+[:./-]", str(self.stored[0]))
            )
        steps = np.diff(self.values[np.isfinite(self.values)])
        return bool(steps.size and np.mean(~(steps > 0)) <= _MOST_RESTARTS)

    @cached_property
    def rises_evenly(self):
        """Whether it increases by equal steps throughout, other than a count of the rows."""
        steps = np.empty(0) if self.values is None else np.diff(self.values)
        if not steps.size or not np.all(steps > 0.0) or np.all(steps == 1.0):
            return False
        return bool(np.all(np.abs(steps / np.median(steps) - 1.0) < JITTER))

    @cached_property
    def counts(self):
        """Whether it counts the rows."""
        values = np.empty(0) if self.values is None else self.values
        return values.size > 1 and bool(np.all(np.diff(values) == 1.0))

    @cached_property
    def changes_seldom(self):
        """Whether most rows repeat the previous one."""
        changes = np.count_nonzero(self.stored[1:] != self.stored[:-1])
        return changes <= _MOST_RESTARTS * len(self.stored)

    @cached_property
    def varies(self):
        """Whether it holds numbers that are not constant."""
        values = np.empty(0) if self.values is None else self.values[np.isfinite(self.values)]
        return bool(values.size and np.ptp(values) > 0.0)

    @cached_property
    def moves(self):
        """Whether it holds numbers that are neither constant nor increasing throughout."""
        return self.varies and not self.rises

    @cached_property
    def is_blank(self):
        """Whether it has no reading."""
        return self.values is not None and not np.isfinite(self.values).any()

    @property
    def called_time(self):
        """Whether the name is that of a time."""
        try:
            return bool(time_unit_of(self.name)) or self.has(TIME)
        except ValueError:  # the unit in brackets is not one of time
            return False


def _names_a_port(words):
    """Whether a name has in or out and a word for the other role: the input of a sensor."""
    others = words - _PORTS
    return any(
        port in words and any(re.fullmatch(_WORDS[0][role], word) for word in others)
        for port, role in (("in", "response"), ("out", "drive"))
    )


def _axes(signals):
    """Return the mark and the names of each of the axes recorded at once, as u1, y1, u2, y2.

    Names of an axis differ from those of another by a number or, where no name has one, by the
    letter x, y or z, the mark. There are no axes if one has a single name.
    """
    names = {c.name: without_unit(c.name).lower() for c in signals}
    mark = next((one for one in _AXIS if any(map(one.search, names.values()))), _AXIS[0])
    axes = {}
    for name, bare in names.items():
        if found := mark.search(bare):
            axes.setdefault(found[0], {})[mark.sub("", bare)] = name
    kinds = [{*axis} for axis in axes.values()]
    alike = len(kinds) > 1 and len(kinds[0]) > 1 and kinds.count(kinds[0]) == len(kinds)
    return mark, [[*axis.values()] for axis in axes.values()] if alike else []


def _time(free):
    """Return the time column and the reason, None if there is none, and the candidates."""
    named = [c for c in free if c.called_time and c.rises]
    if named:  # the time of each signal may be the same
        first, unit = named[0].stored, time_unit_of(named[0].name)
        same = all(np.array_equal(c.stored, first) and time_unit_of(c.name) == unit for c in named)
        return ((named[0], _NAMED), []) if same else (None, named)
    even = [c for c in free if (not c.role or c.has("x")) and c.rises_evenly]  # X_Value of LabVIEW
    if even and all(np.array_equal(c.stored, even[0].stored) for c in even):
        return (even[0], "it alone rises evenly"), []
    clock = [c for c in free if c.values is None and _CLOCK.fullmatch(str(c.stored[0]))]
    if len(clock) == 1:
        return (clock[0], "it alone holds times"), []
    # a column called time that does not increase, since rows are shuffled or repeated: reported as
    # a candidate, so that the rows are not taken for evenly sampled
    named = (c for c in free if re.fullmatch(TIME, without_unit(c.name).lower()))
    return None, [c for c in named if c.varies]


def _named(role, signals, n_roles):
    """Return the signal whose name has the role, and the reason, None if there is none.

    Several candidates are returned with None. ``n_roles`` signals are sought in all.
    """
    alone = [c for c in signals if without_unit(c.name).lower() in _ALONE[role]]
    named = alone if len(alone) == 1 else [c for c in signals if c.role == role]
    moving = [c for c in signals if c.moves]
    if len(moving) > 1 and named != alone:
        named = [c for c in named if c.moves]
    if not named and len(moving) == n_roles:
        named = [c for c in moving if c.has(_LAST[role])]
    if len(named) > 1:
        named = [c for c in named if c.values is not None] or named
    return ((named[0], _NAMED), []) if len(named) == 1 else (None, named)


def _left_over(role, signals, found):
    """Return the only remaining signal whose name allows the role, and the reason.

    Names that exclude no role come first, then those of a quantity that is seldom meant or usually
    has the other role, then those of the other role. Several candidates are returned with None.
    """
    used = [choice[0] for choice in found.values() if choice]
    free = [c for c in signals if not any(c is one for one in used)]
    other = {"drive": "response", "response": "drive"}[role]
    given = other not in found  # then a unit such as V does not show that it is the other
    moving = [c for c in free if c.moves]
    opposite = [c for c in moving if given and c.role == other]
    seldom = [c for c in moving if given and c.has(_LAST[role])]
    levels = [
        [c for c in moving if c.role in ("", "either")],
        seldom + [c for c in opposite if not c.kinds[0]],
        opposite,
        # a ramp, if it is no second time
        [c for c in free if c.varies and c.role in ("", role) and not (c.rises and c.called_time)],
    ]
    possible = next(filter(None, levels), [])
    reason = _LEFT if len(moving) == 1 else _ALLOWED
    if len(possible) == 1 and found.get(other, possible) and (given or not possible[0].role):
        return (possible[0], reason), []
    free = [c for c in free if not c.counts and not c.is_blank]
    free = [c for c in free if c.values is not None] or free
    likely = [c for c in free if c.role in ("", "either", role) or c.has(_LAST[role])]
    return None, likely or [c for c in free if c.role != "neither"] or free


def _either_causes(found):
    """Whether the drive is a force and the response a motion, neither given as the cause."""
    drive, response = (found.get(role) for role in ("drive", "response"))
    if not (drive and response and drive[0].is_force):
        return False
    motion = response[0]
    moves = motion.kinds[1] == {"response"} or motion.has(_LAST["response"])
    return moves or bool(re.fullmatch(_MOTIONS, motion.unit))


def _doubt(columns):
    force, motion = (columns[role].name for role in ("drive", "response"))
    return (
        f"{force!r} is taken for the cause of {motion!r}. Where the motion is set and the force is "
        f"its answer, as of a damper or of friction: pass drive={motion!r} and response={force!r}."
    )


def _question(path, variables, role, candidates):
    if not candidates:
        listed = listed_variables(variables)
        return f"In {path.name} no column is left for the {role}. {listed} {_JOIN}"
    runs = interleaved(path, variables, candidates[0].values) if role == "time" else ""
    shown = ", ".join(repr(c.name) for c in candidates[:_SHOWN])
    if role == "time" and not any(c.rises for c in candidates):
        mend = runs or (
            "Sort the rows by time or, if the stamps are too coarse, pass 'sampling_rate' instead "
            "of 'time'."
        )
        return f"In {path.name} the values of {shown} do not increase from row to row. {mend}"
    may_be = "more than one column may be" if len(candidates) > 1 else "no column is known to be"
    question = f"In {path.name} {may_be} the {role}: pass {role}=NAME. Candidates: {shown}."
    return f"{question} {runs}".rstrip()
