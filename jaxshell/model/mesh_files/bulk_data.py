"""The cards of Nastran bulk data, in small, large and free fields, with the lines of case control above them.

A reader of our own: pyNastran 1.4.1 needs NumPy below 2, and JAX needs NumPy 2.
"""

import re
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from pathlib import Path

from jaxshell.model.mesh_files.files import is_file, text_of

_REAL = re.compile(r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))(?:[ED]([+-]?[0-9]+)|([+-][0-9]+))?")
"""A real number, whose exponent needs no letter: 7.1-3."""
_NAMES = (
    r'\$HMNAME PROP\s+(?P<number>\d+)\s*"(?P<name>[^"]+)"',
    r"\$ANSA_NAME_COMMENT;(?P<number>\d+);P\w+;(?P<name>[^;]+)",
    r"\$\s*Femap Property (?P<number>\d+)\s*:\s*(?P<name>.+)",
)
"""Names of properties in the comments of HyperMesh, ANSA and Femap."""

Lines = list[tuple[str, str]]
"""(text, place) of lines: the place is file and line, for messages."""


@dataclass
class Card:
    """A card of bulk data: its name and fields, of which the first is number 1."""

    name: str
    fields: list[str]
    where: str
    """File and line, for messages."""

    def text(self, position: int) -> str:
        """A field; "" where it is empty or not there."""
        return self.fields[position - 1] if position <= len(self.fields) else ""

    def number(self, position: int, default: float | None = None) -> float:
        """A field as a number. Raises ValueError for anything else, and where it is empty and has no default."""
        text = self.text(position)
        if not text and default is not None:
            return default
        found = _REAL.fullmatch(text.upper())
        if found is None:
            raise ValueError(f"{self.where}: {self._said(position)} should be a number.")
        return float(f"{found[1]}E{found[2] or found[3] or 0}")

    def whole(self, position: int, default: int | None = None) -> int:
        """A field as a whole number. Raises ValueError as `number`."""
        text = self.text(position)
        if not text and default is not None:
            return default
        if not re.fullmatch(r"[+-]?[0-9]+", text):
            raise ValueError(f"{self.where}: {self._said(position)} should be a whole number.")
        return int(text)

    def vector(self, position: int) -> list[float]:
        """Three numbers from a field on; empty ones are 0."""
        return [self.number(position + i, 0.0) for i in range(3)]

    def labels(self, position: int) -> tuple[list[int], bool]:
        """Numbers from a field on, THRU ranges among them, and whether there was one: what lies between may be
        missing."""
        texts = [text for text in self.fields[position - 1 :] if text]
        found, ranged, at = [], False, 0
        while at < len(texts):
            if at + 2 < len(texts) and texts[at + 1].upper() == "THRU":
                step = 1
                if at + 4 < len(texts) and texts[at + 3].upper() == "BY":
                    step = self._label(texts[at + 4])
                found += range(self._label(texts[at]), self._label(texts[at + 2]) + 1, step)
                ranged, at = True, at + (5 if step > 1 else 3)
            else:
                found.append(self._label(texts[at]))
                at += 1
        return found, ranged

    def _label(self, text: str) -> int:
        if not re.fullmatch(r"[0-9]+", text):
            raise ValueError(f"{self.where}: {self.name} has {text!r} where a number of a grid or element should be.")
        return int(text)

    def _said(self, position: int) -> str:
        text = self.text(position)
        return f"field {position} of {self.name}, {text!r}," if text else f"field {position} of {self.name}, empty,"

    def __str__(self) -> str:
        return f"{self.name} {self.text(1)}".strip() + f" ({self.where})"


@dataclass(frozen=True)
class File:
    """A file with those that it includes.

    Arguments:
        control: the lines above BEGIN BULK, without comments; none where the file has no such line.
        cards: the bulk data.
        names: {property: name} of the comments that HyperMesh, ANSA and Femap write.
    """

    control: Lines
    cards: list[Card]
    names: dict[int, str]


def read_file(path: Path) -> File:
    """What a file holds.

    Raises FileNotFoundError, and ValueError with file and line for a file that includes itself or one that is not
    there, superelements, continuations out of order, what begins no card, and what is no text.
    """
    path = Path(path)
    raw = list(_lines(path, path.parent, ()))
    lines = [(text.split("$", 1)[0].rstrip(), where) for text, where in raw]
    lines = [(text.expandtabs(8), where) for text, where in lines if text]
    begin = _begin(lines)
    return File(lines[: max(begin, 0)], _cards(lines[begin + 1 :]), _names(text for text, _ in raw))


def _begin(lines: Lines) -> int:
    """The position of BEGIN BULK; -1 where there is none. Raises ValueError for the bulk data of superelements."""
    found = [i for i, (text, _) in enumerate(lines) if re.match(r"\s*BEGIN(\s|BULK|$)", text, re.IGNORECASE)]
    for i in found:
        text, where = lines[i]
        if i > found[0] or not re.fullmatch(r"\s*BEGIN\s*(BULK)?", text, re.IGNORECASE):
            raise ValueError(f"{where}: superelements are not read, and {text.strip()} begins one.")
    return found[0] if found else -1


def _lines(path: Path, folder: Path, above: tuple[Path, ...]) -> Generator[tuple[str, str], None, bool]:
    """(text, place) of every line up to ENDDATA; returns whether that was there. Files are included from the folder
    of the first one, or beside the one that names them."""
    chain = (*above, path.resolve())
    for number, text in enumerate(text_of(path).splitlines()):
        where = f"{path.name}, line {number + 1}"
        if re.match(r"\s*ENDDATA\b", text, re.IGNORECASE):
            return True
        if not re.match(r"\s*INCLUDE\b", text, re.IGNORECASE):
            yield text, where
            continue
        included = re.fullmatch(r"\s*INCLUDE\s*['\"]?([^'\"$]+?)['\"]?\s*(\$.*)?", text, re.IGNORECASE)
        if included is None:
            raise ValueError(f"{where}: INCLUDE needs the name of a file, in one line.")
        inner = next((place / included[1] for place in (folder, path.parent) if is_file(place / included[1])), None)
        if inner is None:
            raise ValueError(f"{where}: there is no file {included[1]} to include.")
        if inner.resolve() in chain:
            raise ValueError(f"{where}: {inner.name} includes itself.")
        if (yield from _lines(inner, folder, chain)):
            return True
    return False


def _cards(lines: Lines) -> list[Card]:
    """Cards with all their fields; a line that goes on begins with +, * or nothing."""
    cards: list[Card] = []
    mark = ""
    for text, where in lines:
        name, fields, following = _fields(text)
        if name[:1] in ("", "+", "*") and cards:
            if mark and name[1:].strip() not in ("", mark):
                raise ValueError(f"{where}: {name} does not continue the line above it, which goes on with +{mark}.")
            cards[-1].fields += fields
        elif not re.fullmatch(r"[A-Z][A-Z0-9]*\*?", name):
            raise ValueError(f"{where}: {text[:8]!r} begins no card of bulk data.")
        else:
            cards.append(Card(name.rstrip("*"), fields, where))
        mark = following.lstrip("+*").strip()
    return cards


def _fields(text: str) -> tuple[str, list[str], str]:
    """Name, fields, of which a line has 8, or 4 large ones, and the mark of the line that goes on."""
    if "," in text:
        name, *fields = (part.strip() for part in text.split(","))
    else:
        name = text[:8].strip()
        width = 16 if "*" in name else 8
        fields = [text[at : at + width].strip() for at in (*range(8, 72, width), 72)]
    count = 4 if "*" in name else 8
    fields += [""] * (count + 1)
    return name.upper(), fields[:count], fields[count].upper()


def _names(texts: Iterable[str]) -> dict[int, str]:
    """Names of properties in comments."""
    found = {}
    for text in texts:
        if text.startswith("$"):
            for pattern in _NAMES:
                match = re.match(pattern, text, re.IGNORECASE)
                if match:
                    found[int(match["number"])] = match["name"].strip()
    return found
