"""What a search found, as plain data, and as a page to read."""

import base64
import dataclasses
import hashlib
import html
import json
import re
from typing import Self

from .._files import printable, replacing
from ._report_data import collect
from ._report_figures import report_figures
from ._report_page import page, verdict


@dataclasses.dataclass(repr=False)
class Report:
    """Result of a search for missing effects: numbers, tables and signals.

    Make one with :meth:`from_search`. All errors are RMS on samples that the model had not seen,
    in the unit of the response. Only ``seconds`` differs between two runs of the same search.

    Parameters
    ----------
    declared_model, augmented_model : str
        The model that was declared, and with what was found.
    effects : list of str
        Effects claimed, in the order in which they were added.
    verdict : {"noise", "unexplained", "undetermined"}
        What is left over.
    error_before, error_after, noise_floor, response_range : float
        Held-out errors of both models, the error that no model can beat, and the range.
    noise_model : dict
        The fields of the search's :class:`~skhyst.noise.NoiseModel`, and ``text``, which puts
        them into words.
    drive_name, response_name : str
        Names of the columns.
    units : dict of str to str
        Units of ``drive`` and ``response``, "" where nobody has said them, and of ``time``: "s", or
        "sample" where there was none, with frequencies in cycles/sample.
    claims, ranking, not_it : list of dict
        For each effect claimed its law, errors, p-value, ambiguity, experiment and evidence; every
        candidate of every round; for each effect not claimed the round in which it helped most.
    folds : list of dict
        For each record and fold the samples scored and their errors ``before`` and ``after``.
    parameters : dict of str to list of dict
        ``"declared"`` and ``"augmented"``: name, value, standard error, unit ("" where it has none
        or is not known), and a note where it has no error: at a bound, or not determined by the
        data.
    data, settings, versions, seconds : dict
        The recording, its faults, the part of it that folds extrapolate to and the reference of its
        loop, parameters of the search, packages, time by stage in s.
    held_out : dict or None
        Errors on data that was kept from the search altogether.
    command : str or None
        The command that made the report.
    spectra : dict of str to list of float
        ``frequency`` (Hz) and the amplitude spectral density of the residual, ``before`` and
        ``after``, of the records of each sampling ``interval`` (s), one after the other.
    location, declared_location : list of dict
        Where what is left, and what the declared model leaves, stands out: the record, time, drive,
        rate and frequency at which its mean power is above that of the whole by a half.
    failed : list of dict
        Candidates that raised an error: round, effect, error.
    dropped, next_steps : list of str
        Effects that later claims made needless, and what to measure next.
    signals : dict
        Arrays for the pictures; not part of :meth:`to_dict`.

    Examples
    --------
    A fitted search makes its report::

        report = search.report()
        report.to_html("report.html")
        report.to_dict()["effects"]
    """

    declared_model: str
    augmented_model: str
    effects: list
    verdict: str
    error_before: float
    error_after: float
    noise_floor: float
    response_range: float
    noise_model: dict
    drive_name: str
    response_name: str
    units: dict
    claims: list
    ranking: list
    not_it: list
    folds: list
    parameters: dict
    data: dict
    settings: dict
    held_out: dict | None
    versions: dict
    seconds: dict
    command: str | None
    spectra: dict
    location: list
    declared_location: list
    dropped: list
    failed: list
    next_steps: list
    signals: dict = dataclasses.field(repr=False)

    @classmethod
    def from_search(cls, search, command=None, *, held_out=None) -> Self:
        """Collect what a fitted search found.

        Parameters
        ----------
        search : EffectSearchCV
            Fitted.
        command : str or None, default=None
            The command that ran it.
        held_out : tuple (X, y) or None, default=None
            Data that the search has not seen, to report the error on.

        Returns
        -------
        Report
        """
        return cls(**collect(search, command, held_out))

    @property
    def rounds(self) -> list[int]:
        """Numbers of the rounds, in order."""
        return sorted({row["round"] for row in self.ranking})

    @property
    def headline(self) -> str:
        """The verdict in a few words."""
        return verdict(self)[0]

    @property
    def sentence(self) -> str:
        """The verdict, after what to beware of: what is missing, the errors, the noise floor."""
        return verdict(self)[1]

    def __repr__(self):
        return f"Report: {self.headline}. {self.sentence}"

    def _repr_html_(self):
        """Show what was found in a notebook; :meth:`to_html` has all of it."""
        claims = "".join(
            f"<li><b>{html.escape(claim['effect'])}</b>: {html.escape(claim['statement'])}</li>"
            for claim in self.claims
        )
        head = f"<b>{html.escape(self.headline)}</b><p>{html.escape(self.sentence)}</p>"
        return f"<div>{head}{f'<ul>{claims}</ul>' if claims else ''}</div>"

    def to_dict(self) -> dict:
        """Return everything but the signals, as plain Python data; NaN and infinity are None."""
        summary = {"headline": self.headline, "sentence": self.sentence}
        fields = {name: value for name, value in vars(self).items() if name != "signals"}
        text = json.dumps({"schema": "skhyst.report/1"} | summary | fields, default=_plain)
        return json.loads(text, parse_constant=lambda _: None)

    def to_html(self, path=None) -> str:
        """Return a self-contained page: no other file, nothing from a network.

        One script of its own, which the page allows by its hash and no other, tells values under
        the pointer and zooms: drag a rectangle, and a double click goes back.

        Parameters
        ----------
        path : str, Path or None, default=None
            File to write as well. One that is there is replaced when the new one is whole.

        Returns
        -------
        str

        Raises
        ------
        ImportError
            Where matplotlib or Jinja2 is not installed.
        OSError
            If the file cannot be written, or is a link; what was there is left as it was.
        """
        return _written(_rendered(self, "html"), path)

    def to_markdown(self, path=None) -> str:
        """Return the text and the tables without pictures; otherwise as :meth:`to_html`."""
        return _written(_rendered(self, "markdown"), path)

    def to_json(self, path=None) -> str:
        """Return :meth:`to_dict` as JSON text, written to a file ``path`` where one is given."""
        content = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        return _written(printable(content), path)


def _plain(value):
    """Return what JSON has in place of a NumPy value or a picture."""
    if hasattr(value, "curves"):
        curves = [{"label": c[0], "style": c[3], "x": c[1], "y": c[2]} for c in value.curves]
        return vars(value) | {"curves": curves}
    return value.tolist()


def _rendered(report, form):
    """Return the page in a form, or say how to install what it needs."""
    try:
        import jinja2
    except ImportError as error:
        raise ImportError(
            "A report as HTML or Markdown needs Jinja2, which is not installed. "
            'Install it with: python -m pip install "skhyst[plot]"'
        ) from error
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("skhyst.diagnosis", "_templates"),
        autoescape=form == "html",
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["md"] = _markdown_text
    environment.filters["nobreak"] = lambda value: re.sub(r"(?<=\d) (?=%|×)", "\u00a0", str(value))
    figures = report_figures(report) if form == "html" else None
    template, blocks = environment.get_template("report.j2"), page(report, figures)
    script = environment.loader.get_source(environment, "pictures.js")[0]
    own = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    filled = {"form": form, "headline": report.headline, "blocks": blocks}
    return printable(template.render(**filled, script=script, script_hash=own))


def _markdown_text(value):
    """Escape what Markdown or HTML inside it would read as markup."""
    return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", str(value)).replace("\n", " ")


def _written(content, path):
    """Write the content where a path is given, and return it."""
    if path is not None:
        with replacing(path) as (part,):
            part.write_text(content, encoding="utf-8")
    return content
