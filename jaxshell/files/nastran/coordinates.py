"""Coordinate systems of a Nastran file: CORD1R, CORD1C, CORD1S, CORD2R, CORD2C, CORD2S."""

import numpy as np

from jaxshell.files.nastran.cards import Card, Deck

_CARDS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")


class System:
    """A system with its origin (3,), its axes (rows, 3 by 3) in the basic system, and its kind, R, C or S."""

    def __init__(self, origin, axes, kind: str):
        self.origin, self.axes, self.kind = origin, axes, kind

    def point(self, coordinates) -> np.ndarray:
        """Coordinates in this system as a point (3,) in the basic one."""
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


class Systems:
    """All systems of a file by their numbers; 0 is the basic one."""

    def __init__(self, deck: Deck):
        self._cards: dict[int, tuple[Card, int]] = {}
        for card in deck.named(*_CARDS):
            self._cards[card.whole(1)] = (card, 1)
            if card.name.startswith("CORD1") and card.text(5):
                self._cards[card.whole(5)] = (card, 5)
        self._grids = {card.whole(1): card for card in deck.named("GRID")}
        self._default = next(iter(deck.named("GRDSET")), Card("GRDSET", [], ""))
        self._made = {0: System(np.zeros(3), np.eye(3), "R")}
        self._points: dict[int, np.ndarray] = {}
        self._open: set[int] = set()

    def __getitem__(self, number: int) -> System:
        """Raises ValueError for one that there is not, and for one that is defined by itself."""
        if number not in self._made:
            if number not in self._cards:
                raise ValueError(f"There is no coordinate system {number}.")
            card, at = self._cards[number]
            if number in self._open:
                raise ValueError(f"{card.where}: coordinate system {number} is defined by itself.")
            self._open.add(number)
            if card.name.startswith("CORD1"):
                a, b, c = (self.grid(card.whole(at + i)) for i in (1, 2, 3))
            else:
                base = self[card.whole(2, 0)]
                a, b, c = (base.point(card.vector(3 * k)) for k in (1, 2, 3))
            z, plane = b - a, c - a
            y = np.cross(z, plane)
            sizes = np.linalg.norm(z), np.linalg.norm(y)
            if not min(sizes) > 0:
                raise ValueError(f"{card.where}: the points of coordinate system {number} span none.")
            z, y = z / sizes[0], y / sizes[1]
            self._made[number] = System(a, np.stack([np.cross(y, z), y, z]), card.name[-1])
        return self._made[number]

    def grid(self, label: int) -> np.ndarray:
        """(3,) a grid point in the basic system. Raises ValueError for one that there is not."""
        if label not in self._points:
            if label not in self._grids:
                raise ValueError(f"There is no GRID {label}.")
            card = self._grids[label]
            system = card.whole(2, self._default.whole(2, 0))
            self._points[label] = self[system].point(card.vector(3))
        return self._points[label]

    def of_displacements(self, label: int) -> System:
        """The system in which a grid point's degrees of freedom are counted (CD)."""
        return self[self._grids[label].whole(6, self._default.whole(6, 0))]

    def held(self, label: int) -> str:
        """The digits of a grid point's permanent supports (PS)."""
        card = self._grids[label]
        return card.text(7) or self._default.text(7)
