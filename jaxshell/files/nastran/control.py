"""Executive and case control of a Nastran file: its solution, and what its subcases choose of the bulk data."""

import re
from dataclasses import dataclass, field

from jaxshell.model.mesh_files.bulk_data import Card, File, Lines


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


def deck_of_file(file: File) -> Deck:
    """A file with its lines of control understood."""
    deck = Deck(cards=file.cards)
    _control(file.control, deck)
    return deck


def _control(lines: Lines, deck: Deck) -> None:
    for text, _ in lines:
        words = text.strip().upper()
        if words.startswith("SOL ") or words.startswith("SOL,"):
            deck.solution = re.split(r"[ ,]+", words)[1]
        elif words.startswith("SUBCASE"):
            deck.subcases.append(dict(deck.subcases[0]))
        elif "=" in words:
            key, _, value = words.partition("=")
            deck.subcases[-1][key.split("(")[0].strip()] = value.strip()
