"""Grid points and coordinate systems of Nastran bulk data: GRID, GRDSET, CORD1R, CORD1C, CORD1S, CORD2R, CORD2C and
CORD2S."""

from collections.abc import Iterable

import numpy as np

from jaxshell.model.mesh_files.bulk_data import Card

_SYSTEMS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
CARDS = ("GRID", "GRDSET", *_SYSTEMS)
"""What is read here."""


class System:
    """A system with its origin (3,), its axes (rows, 3 by 3) in the basic system, and its kind, R, C or S."""

    def __init__(self, origin, axes, kind: str):
        self.origin, self.axes, self.kind = origin, axes, kind

    def point(self, coordinates) -> np.ndarray:
        """Coordinates in this system, angles in degrees, as a point (3,) in the basic one."""
        a, b, c = coordinates
        if self.kind == "C":
            local = [a * np.cos(np.deg2rad(b)), a * np.sin(np.deg2rad(b)), c]
        elif self.kind == "S":
            theta, phi = np.deg2rad(b), np.deg2rad(c)
            local = [a * np.sin(theta) * np.cos(phi), a * np.sin(theta) * np.sin(phi), a * np.cos(theta)]
        else:
            local = [a, b, c]
        return self.origin + np.array(local) @ self.axes

    def vector(self, components, card: Card) -> np.ndarray:
        """Components in this system as a vector (3,) in the basic one. Raises ValueError for one that is curved, where
        the vector depends on the place."""
        if self.kind != "R":
            raise ValueError(f"{card.where}: {card.name} is read in rectangular systems only, and its own is curved.")
        return np.asarray(components, float) @ self.axes


BASIC = System(np.zeros(3), np.eye(3), "R")


class Systems:
    """The grid points and all systems of a file. Raises ValueError with file and line for those that are defined
    twice."""

    def __init__(self, cards: Iterable[Card]):
        self._cards: dict[int, tuple[Card, int]] = {}
        self._grids: dict[int, Card] = {}
        self._default = Card("GRDSET", [], "")
        for card in cards:
            if card.name == "GRID":
                taken(self._grids, card, "grid point")
            elif card.name == "GRDSET":
                if self._default.fields not in ([], card.fields):
                    raise ValueError(f"{card.where}: GRDSET is there twice.")
                self._default = card
            elif card.name in _SYSTEMS:
                self._define(card)
        self._made = {0: BASIC}
        self._points: dict[int, np.ndarray] = {}
        self._open: set[int] = set()

    def _define(self, card: Card) -> None:
        """CORD1R and its like define two systems where their fields 5 to 8 are given."""
        for at in (1, 5) if card.name.startswith("CORD1") and card.text(5) else (1,):
            other, where = self._cards.get(card.whole(at), (card, at))
            if (other.name, other.fields, where) != (card.name, card.fields, at):
                raise ValueError(f"{card.where}: coordinate system {card.whole(at)} is defined twice.")
            self._cards[card.whole(at)] = (card, at)

    def grids(self) -> dict[int, np.ndarray]:
        """{number: (3,) point in the basic system}, in the order of the file."""
        return {label: self.grid(label, card) for label, card in self._grids.items()}

    def system(self, number: int, card: Card) -> System:
        """The system that a card names; 0 is the basic one. Raises ValueError for one that there is not, and for one
        that is defined by itself."""
        if number in self._made:
            return self._made[number]
        if number not in self._cards or number in self._open:
            said = "which is defined by itself" if number in self._cards else "which is not there"
            raise ValueError(f"{card.where}: {card.name} {card.text(1)} is in coordinate system {number}, {said}.")
        own, at = self._cards[number]
        self._open.add(number)
        if own.name.startswith("CORD1"):
            a, b, c = (self.grid(own.whole(at + i), own) for i in (1, 2, 3))
        else:
            base = self.system(own.whole(2, 0), own)
            a, b, c = (base.point(own.vector(3 * k)) for k in (1, 2, 3))
        self._open.discard(number)
        self._made[number] = System(a, _axes(a, b, c, own.where), own.name[-1])
        return self._made[number]

    def grid(self, label: int, card: Card) -> np.ndarray:
        """(3,) a grid point that a card names, in the basic system. Raises ValueError for one that there is not."""
        if label not in self._points:
            if label not in self._grids:
                raise ValueError(
                    f"{card.where}: {card.name} {card.text(1)} names grid point {label}, which is not there."
                )
            own = self._grids[label]
            system = self.system(own.whole(2, self._default.whole(2, 0)), own)
            self._points[label] = system.point(own.vector(3))
        return self._points[label]

    def of_displacements(self, label: int) -> System:
        """The system in which a grid point's degrees of freedom are counted (CD)."""
        card = self._grids[label]
        return self.system(card.whole(6, self._default.whole(6, 0)), card)

    def held(self) -> list[tuple[Card, str]]:
        """Grid points that are held for good, each with the digits of its degrees of freedom (PS)."""
        every = [(card, card.text(7) or self._default.text(7)) for card in self._grids.values()]
        return [(card, digits) for card, digits in every if digits]


def taken(cards: dict[int, Card], card: Card, what: str) -> None:
    """Take a card under its number. Raises ValueError where another one has that."""
    number = card.whole(1)
    other = cards.setdefault(number, card)
    if (other.name, other.fields) != (card.name, card.fields):
        raise ValueError(f"{card.where}: {what} {number} is defined twice.")


def _axes(a: np.ndarray, b: np.ndarray, c: np.ndarray, where: str) -> np.ndarray:
    """(3, 3) the axes, one a row: z from a to b, and c in the plane of x and z."""
    z = b - a
    y = np.cross(z, c - a)
    if not np.linalg.norm(y) > 0:
        raise ValueError(f"{where}: the three points of the coordinate system lie on one line.")
    return np.stack([v / np.linalg.norm(v) for v in (np.cross(y, z), y, z)])
