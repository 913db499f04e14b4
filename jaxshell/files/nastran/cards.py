"""The cards of a Nastran file: executive and case control, and bulk data in small, large and free fields.

A reader of our own: pyNastran 1.4.1 needs NumPy below 2, and JAX needs NumPy 2.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

from jaxshell.model.mesh_files.files import is_file, text_of

_EXPONENT = re.compile(r"^([+-]?(?:\d+\.?\d*|\.\d+))([+-]\d+)$")
"""A real number whose exponent has no letter: 7.1-3."""


@dataclass
class Card:
    """A card of bulk data: its name and fields, of which the first is number 1."""

    name: str
    fields: list[str]
    where: str

    def text(self, position: int) -> str:
        """A field; "" where it is empty or not there."""
        return self.fields[position - 1] if position <= len(self.fields) else ""

    def number(self, position: int, default: float | None = None) -> float:
        """A field as a number. Raises ValueError for anything else, and where it is empty and has no default."""
        text = self.text(position)
        if not text and default is not None:
            return default
        plain = text.upper().replace("D", "E")
        if found := _EXPONENT.match(plain):
            plain = f"{found[1]}E{found[2]}"
        try:
            return float(plain)
        except ValueError:
            raise ValueError(f"{self.where}: {self._said(position)} should be a number.") from None

    def whole(self, position: int, default: int | None = None) -> int:
        """A field as a whole number. Raises ValueError as `number`."""
        text = self.text(position)
        if not text and default is not None:
            return default
        try:
            return int(text)
        except ValueError:
            raise ValueError(f"{self.where}: {self._said(position)} should be a whole number.") from None

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
        if not text.isdigit():
            raise ValueError(f"{self.where}: {self.name} has {text!r} where a number of a grid or element should be.")
        return int(text)

    def _said(self, position: int) -> str:
        text = self.text(position)
        return f"field {position} of {self.name}, {text!r}," if text else f"field {position} of {self.name}, empty,"

    def __str__(self) -> str:
        return f"{self.name} {self.text(1)}".strip() + f" ({self.where})"


@dataclass
class Deck:
    """A file: its solution, its case control, and its bulk data."""

    solution: str = ""
    subcases: list[dict[str, str]] = field(default_factory=lambda: [{}])
    """Case control: that above all subcases, and each subcase with it; keys in capitals."""
    cards: list[Card] = field(default_factory=list)

    def named(self, *names: str) -> list[Card]:
        """The cards of these names, in the order of the file."""
        return [card for card in self.cards if card.name in names]

    def chosen(self, case: dict[str, str], key: str) -> int:
        """The number that case control gives for a key; 0 where it gives none. Raises ValueError for anything else."""
        text = case.get(key, "0")
        if not text.isdigit():
            raise ValueError(f"Case control has {key} = {text}, which should be a number.")
        return int(text)

    @property
    def first(self) -> dict[str, str]:
        """Case control of the first subcase."""
        return self.subcases[1] if len(self.subcases) > 1 else self.subcases[0]


def read_deck(path: Path) -> Deck:
    """The cards of a file with those that it includes.

    Raises FileNotFoundError, and ValueError with file and line for a file that includes itself and what is no text.
    """
    path = Path(path)
    deck = Deck()
    lines = _lines(path, path.parent, ())
    bulk = next((i for i, (text, _) in enumerate(lines) if "".join(text.upper().split()).startswith("BEGIN")), -1)
    if bulk >= 0:
        _control(lines[:bulk], deck)
    _bulk(lines[bulk + 1 :], deck)
    return deck


def _lines(path: Path, folder: Path, above: tuple[Path, ...]) -> list[tuple[str, str]]:
    """(text without its comment, place) of every line."""
    chain, found = (*above, path.resolve()), []
    for number, text in enumerate(text_of(path).splitlines()):
        text, where = text.split("$", 1)[0].rstrip(), f"{path.name}, line {number + 1}"
        if not text:
            continue
        if not text.upper().startswith("INCLUDE"):
            found.append((text.expandtabs(8), where))
            continue
        name = text[7:].strip().strip("'\"")
        inner = next((place / name for place in (folder, path.parent) if is_file(place / name)), None)
        if inner is None:
            raise ValueError(f"{where}: there is no file {name} to include.")
        if inner.resolve() in chain:
            raise ValueError(f"{where}: {inner.name} includes itself.")
        found += _lines(inner, folder, chain)
    return found


def _control(lines: list[tuple[str, str]], deck: Deck) -> None:
    for text, _ in lines:
        words = text.strip().upper()
        if words.startswith("SOL ") or words.startswith("SOL,"):
            deck.solution = re.split(r"[ ,]+", words)[1]
        elif words.startswith("SUBCASE"):
            deck.subcases.append(dict(deck.subcases[0]))
        elif "=" in words:
            key, _, value = words.partition("=")
            deck.subcases[-1][key.split("(")[0].strip()] = value.strip()


def _bulk(lines: list[tuple[str, str]], deck: Deck) -> None:
    for text, where in lines:
        if text.strip().upper().startswith("ENDDATA"):
            break
        name, fields = _fields(text)
        if not name and deck.cards:
            deck.cards[-1].fields += fields
        elif not re.fullmatch(r"[A-Z][A-Z0-9]*", name):
            raise ValueError(f"{where}: {text[:8]!r} begins no card of bulk data.")
        else:
            deck.cards.append(Card(name, fields, where))


def _fields(text: str) -> tuple[str, list[str]]:
    """Name ("" of a line that goes on) and fields, of which a line has 8, or 4 large ones."""
    if "," in text:
        name, *fields = [part.strip() for part in text.split(",")]
    else:
        name, width = text[:8].strip(), 16 if "*" in text[:8] else 8
        fields = [text[at : at + width].strip() for at in range(8, 72, width)]
    count = 4 if "*" in name else 8
    fields = (fields + [""] * count)[:count]
    return ("" if name[:1] in ("", "+", "*") else name.rstrip("*").upper()), fields
