"""Units of drive, response and time, as text."""

import re
from dataclasses import dataclass

_PER_SAMPLE = (  # where the sampling interval is not known
    (re.compile(r"√Hz\b"), "√(cycles/sample)"),
    (re.compile(r"\bHz\b"), "cycles/sample"),
    (re.compile(r"(?<=/)s\b"), "sample"),
    (re.compile(r"(?<![\w/])s\b"), "samples"),
)


@dataclass(frozen=True)
class Units:
    """Units of a recording's drive, response and time.

    Parameters
    ----------
    drive, response : str, default=""
        "" if they are not known.
    time : {"s", "sample"}, default="s"
        "sample" where the sampling interval is not known: frequencies are then in cycles/sample.

    See Also
    --------
    read_records : Puts the units of a file into the names of columns.

    Examples
    --------
    >>> from skhyst.records import Units
    >>> Units("V", "um").of("response/drive"), Units().of("drive/s"), Units("V", "V").of("V/V")
    ('um/V', 'drive/s', '')
    >>> Units(time="sample").of("Hz"), Units("V").label("rate (drive/s)")
    ('cycles/sample', 'rate (V/s)')
    """

    drive: str = ""
    response: str = ""
    time: str = "s"

    def in_time(self, text) -> str:
        """Return a text with "s" and "Hz" replaced if time counts samples.

        Parameters
        ----------
        text : str
            In s and Hz.

        Returns
        -------
        str
            In samples and cycles/sample, or as it was.
        """
        for pattern, words in _PER_SAMPLE if self.time == "sample" else ():
            text = pattern.sub(words, text)
        return text

    def of(self, unit) -> str:
        """Return a unit in those of the recording.

        Parameters
        ----------
        unit : str
            In terms of drive, response, s and Hz, such as ``"response/drive"``.

        Returns
        -------
        str
            The unit, "" if it cancels.
        """
        words = {"drive": self.drive, "response": self.response}
        unit = re.sub(
            r"\b(drive|response)\b", lambda w: words[w.group()] or w.group(), self.in_time(unit)
        )
        return re.sub(r"^(\S+)/\1$", "", unit)

    def label(self, text) -> str:
        """Return an axis label in the units of the recording.

        Parameters
        ----------
        text : str
            Label with a unit in brackets at its end, in terms of drive, response, s and Hz.

        Returns
        -------
        str
            The label.
        """
        return re.sub(r"\(([^()]+)\)$", lambda found: f"({self.of(found.group(1))})", text)
