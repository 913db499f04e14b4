"""The cards of an Abaqus or CalculiX input file: keyword, options and data lines, each with its place in the file.

`**` begins a comment, a comma at the end of a keyword's line goes on in the next one, *INCLUDE puts another file in
its place. Keywords, options and names count the same in capitals and small letters.
"""

from dataclasses import dataclass, field
from pathlib import Path

from jaxshell.model.mesh_files.files import is_file, text_of


@dataclass
class Line:
    """A data line: its fields, without blanks around them."""

    fields: list[str]
    where: str
    """File and line, for messages."""

    def text(self, position: int) -> str:
        """A field; "" where it is empty or not there."""
        return self.fields[position] if position < len(self.fields) else ""

    def number(self, position: int, default: float | None = None) -> float:
        """A field as a number. Raises ValueError for anything else, and where it is empty and has no default."""
        text = self.text(position)
        if not text and default is not None:
            return default
        try:
            return float(text.lower().replace("d", "e"))
        except ValueError:
            raise ValueError(f"{self.where}: {_said(text, position)} should be a number.") from None

    def whole(self, position: int, default: int | None = None) -> int:
        """A field as a whole number. Raises ValueError as `number`."""
        text = self.text(position)
        if not text and default is not None:
            return default
        try:
            return int(text)
        except ValueError:
            raise ValueError(f"{self.where}: {_said(text, position)} should be a whole number.") from None

    def numbers(self) -> list[float]:
        """All fields as numbers, an empty last one left out."""
        return [self.number(position) for position in range(len(self.fields))]


def _said(text: str, position: int) -> str:
    return f"field {position + 1}, {text!r}," if text else f"field {position + 1}, which is empty,"


@dataclass
class Card:
    """A keyword with its options and data lines."""

    keyword: str
    """In capitals, without blanks: "SHELLSECTION"."""
    title: str
    """As messages show it: "*SHELL SECTION"."""
    options: dict[str, str]
    """In capitals, without blanks; "" for one without a value, and values as they are written."""
    where: str
    lines: list[Line] = field(default_factory=list)

    def option(self, name: str) -> str:
        """The value of an option that must be there. Raises ValueError where it is not."""
        if not self.options.get(name):
            raise ValueError(f"{self.where}: {self.title} needs {name}=.")
        return self.options[name]

    def value(self, name: str, default: float = 0.0) -> float:
        """The value of an option as a number. Raises ValueError for anything else."""
        text = self.options.get(name, "")
        try:
            return float(text.lower().replace("d", "e")) if text else default
        except ValueError:
            raise ValueError(f"{self.where}: {name}={text!r} of {self.title} should be a number.") from None

    def choice(self, name: str, default: str) -> str:
        """The value of an option in capitals."""
        return (self.options.get(name) or default).upper()

    def line(self, position: int) -> Line:
        """A data line that must be there. Raises ValueError where it is not."""
        if position >= len(self.lines):
            raise ValueError(f"{self.where}: {self.title} needs data line {position + 1}.")
        return self.lines[position]

    def __str__(self) -> str:
        return f"{self.title} ({self.where})"


def read_cards(path: Path) -> list[Card]:
    """All cards of a file, with those of the files that it includes.

    Raises FileNotFoundError, and ValueError with file and line for data before the first keyword, *PARAMETER, a file
    that includes itself, and what is no text.
    """
    cards: list[Card] = []
    _read(Path(path), Path(path).parent, (), cards)
    return cards


def _read(path: Path, folder: Path, above: tuple[Path, ...], cards: list[Card]) -> None:
    lines = text_of(path).splitlines()
    chain = (*above, path.resolve())
    number = 0
    while number < len(lines):
        text, where = lines[number].strip(), f"{path.name}, line {number + 1}"
        number += 1
        if not text or text.startswith("**"):
            continue
        if not text.startswith("*"):
            if not cards:
                raise ValueError(f"{where}: the file begins with data, not with a keyword such as *NODE.")
            cards[-1].lines.append(Line([part.strip() for part in text.split(",")], where))
            continue
        while text.endswith(",") and number < len(lines):
            text += lines[number].strip()
            number += 1
        card = _card(text, where)
        if card.keyword == "INCLUDE":
            _read(_included(card, folder, path.parent, chain), folder, chain, cards)
        elif card.keyword == "PARAMETER":
            raise ValueError(f"{where}: *PARAMETER is not read: write its values where <names> stand for them.")
        else:
            cards.append(card)


def _card(text: str, where: str) -> Card:
    words, *rest = text.lstrip("*").split(",")
    options = {}
    for part in rest:
        name, _, value = part.partition("=")
        if name.strip():
            options["".join(name.split()).upper()] = value.strip().strip("\"'")
    title = "*" + " ".join(words.split()).upper()
    return Card("".join(words.split()).upper(), title, options, where)


def _included(card: Card, folder: Path, beside: Path, chain: tuple[Path, ...]) -> Path:
    """The file that an *INCLUDE names: from the folder of the first file, or beside the one that names it."""
    name = card.option("INPUT")
    for place in (folder, beside):
        found = place / name
        if is_file(found):
            if found.resolve() in chain:
                raise ValueError(f"{card.where}: {found.name} includes itself.")
            return found
    raise ValueError(f"{card.where}: there is no file {name} to include.")
