"""How skhyst cites: ``Author and Author, *Journal*, year``, looked up in ``references.bib``.

At most three authors are named, of more the first one with "et al."; in asterisks is the journal
or the proceedings, for a book the title up to a colon. A text that cites a work again says
"Author (year)". So a docstring is readable in a terminal, and these pages add the link to the full
entry.
"""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

_ENTRY = re.compile(r"^@\w+\{(\w+),\n(.*?)^\}", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^  (\w+) = \{(.*)\},$", re.MULTILINE)


@dataclass(frozen=True)
class Reference:
    """The citation of an entry of the bibliography."""

    key: str
    authors: str
    container: str
    year: str

    @property
    def citation(self):
        """The citation as text."""
        return f"{self.authors}, *{self.container}*, {self.year}"

    @cached_property
    def pattern(self):
        """The citation as a regular expression, wherever its lines break."""
        return re.compile("(" + re.escape(self.citation).replace(r"\ ", r"\s+") + ")")


def read_references(path=Path(__file__).parent / "references.bib"):
    """Return the entries of the bibliography, one field per line, by their keys."""
    found = {}
    for key, body in _ENTRY.findall(Path(path).read_text(encoding="utf-8")):
        fields = {name: re.sub(r"[{}]", "", value) for name, value in _FIELD.findall(body)}
        title = fields["title"].split(":")[0]
        container = fields.get("journal", fields.get("booktitle", title))
        found[key] = Reference(key, _authors(fields["author"]), container, fields["year"])
    return found


def _authors(names):
    """Return the family names of authors as cited in a text."""
    family = [name.split(",")[0] for name in names.split(" and ")]
    if len(family) > 3 or "others" in family:
        return f"{family[0]} et al."
    return " and ".join([", ".join(family[:-1]), family[-1]] if len(family) > 1 else family)


def add_keys(text, references):
    """Return a text with the keys of the bibliography after its citations."""
    for reference in references.values():
        if reference.year in text:  # next to all texts cite nothing
            text = reference.pattern.sub(rf"\1 :cite:`{reference.key}`", text)
    return text
