"""Supports and loads that case control chooses, as tables of a scene file.

In statics and buckling they act in proportion to the load factor. In transient solutions static loads have the course
of a TLOAD1 with its TABLED1, which goes on along its last line, as Nastran's does, up to the end of the run.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from jaxshell.files.draft import Forces, Holds, Notes, with_history
from jaxshell.files.nastran.control import Deck
from jaxshell.files.nastran.geometry import Geometry
from jaxshell.model.mesh_files.bulk_data import Card

STATIC = ("FORCE", "MOMENT", "PLOAD2", "PLOAD4", "GRAV")
BEYOND = (
    "FORCE1", "FORCE2", "MOMENT1", "MOMENT2", "PLOAD", "PLOAD1", "RFORCE", "ACCEL", "ACCEL1", "SPCD", "TEMP", "TEMPD",
    "TEMPP1", "RLOAD1", "RLOAD2", "TLOAD2",
)  # fmt: skip
"""Loads that have no counterpart."""


class Loads:
    """`end` is the time at which the run ends; `ramp` that at which statics has the whole load."""

    def __init__(self, deck: Deck, geometry: Geometry, notes: Notes, end: float):
        self._deck, self._geometry, self._notes, self._end = deck, geometry, notes, end
        self._histories: dict[Any, dict[str, Any] | None] = {"ramp": {"ramp": end}}
        self._holds, self._forces = Holds(), Forces()
        self._on_shell: list[dict[str, Any]] = []

    def tables(self) -> dict[str, Any]:
        """[[supports]] and [[loads]]."""
        found = {
            "supports": self._holds.tables(self._histories),
            "loads": self._forces.tables(self._histories) + self._on_shell,
        }
        return {key: value for key, value in found.items() if value}

    # --- supports ----------------------------------------------------------------------------------------

    def supports(self, sets: int) -> None:
        """The supports of SPC=, and the permanent ones of the grid points."""
        for card, digits in self._geometry.systems.held():
            self._hold([card.whole(1)], digits, card, False)
        if not sets:
            return
        wanted = {sets}
        for card in self._deck.named("SPCADD"):
            if card.whole(1) == sets:
                wanted = set(card.labels(2)[0])
        found = [card for card in self._deck.named("SPC", "SPC1") if card.whole(1) in wanted]
        if not found:
            raise ValueError(f"Case control has SPC = {sets}, which no SPC, SPC1 or SPCADD has.")
        for card in found:
            self._notes.carried["supports"] += 1
            if card.name == "SPC1":
                labels, ranged = card.labels(3)
                self._hold(labels, card.text(2), card, ranged)
                continue
            for at in (2, 5):
                if card.text(at):
                    self._spc(card, at)

    def _spc(self, card: Card, at: int) -> None:
        label, digits, value = card.whole(at), card.text(at + 1), card.number(at + 2, 0.0)
        if not value:
            self._hold([label], digits, card, False)
            return
        target, nodes = self._geometry.nodes([label], False, card)
        self._check_system([label], digits, card, moved=True)
        if set(digits) - set("123"):
            self._notes.missing.append(f"prescribed rotation of {card}")
            return
        for digit in digits if nodes.size else "":
            self._holds.move(target, nodes, int(digit) - 1, value, "ramp")

    def _hold(self, labels: list[int], digits: str, card: Card, ranged: bool) -> None:
        digits = digits.replace("0", "")
        if set(digits) - set("123456"):
            raise ValueError(f"{card.where}: {card.name} holds {digits!r}, and degrees of freedom are 1 to 6.")
        target, nodes = self._geometry.nodes(labels, ranged, card)
        if not nodes.size or not digits:
            return
        self._check_system(labels, digits, card)
        self._holds.hold(target, nodes, [int(digit) - 1 for digit in digits])

    def _check_system(self, labels: list[int], digits: str, card: Card, moved: bool = False) -> None:
        """Raise ValueError where degrees of freedom are counted in a turned system (CD) and a part of them is held."""
        whole = all(set(part) <= set(digits) or not set(part) & set(digits) for part in ("123", "456"))
        if whole and not moved:
            return
        for label in labels:
            try:
                system = self._geometry.systems.of_displacements(label)
            except KeyError:
                continue
            if system.kind != "R" or not np.allclose(system.axes, np.eye(3), atol=1e-12):
                raise ValueError(
                    f"{card.where}: {card.name} holds {digits} of GRID {label} in a system of its own (CD); only all "
                    "three displacements or rotations may be held in one, since jaxshell counts in global axes."
                )

    # --- loads -------------------------------------------------------------------------------------------

    def static(self, load: int, history: Any = "ramp") -> None:
        """The loads of LOAD=, combined by a LOAD card where it is one."""
        for factor, number in self._combined("LOAD", load):
            found = [card for card in self._deck.named(*STATIC) if card.whole(1) == number]
            others = [card for card in self._deck.named(*BEYOND) if card.whole(1) == number]
            self._notes.missing += [f"{card.name} of load {number} ({card.where})" for card in others]
            if not found and not others:
                raise ValueError(f"Case control has LOAD = {load}, but there is no load {number}.")
            for card in found:
                self._add(card, factor, history)

    def transient(self, load: int) -> None:
        """The loads of DLOAD=, each with the course of its TLOAD1."""
        for factor, number in self._combined("DLOAD", load):
            found = [card for card in self._deck.named("TLOAD1") if card.whole(1) == number]
            others = [card for card in self._deck.named("TLOAD2", "RLOAD1", "RLOAD2") if card.whole(1) == number]
            self._notes.missing += [f"{card.name} {number} ({card.where})" for card in others]
            if not found and not others:
                raise ValueError(f"Case control has DLOAD = {load}, but there is no TLOAD1 {number}.")
            for card in found:
                self._tload(card, factor)

    def _tload(self, card: Card, factor: float) -> None:
        if card.text(4) not in ("", "0", "LOAD"):
            raise ValueError(f"{card.where}: TLOAD1 {card.text(1)} is read of type 0 or LOAD only, a force.")
        if "." not in card.text(3) and card.whole(3, 0):
            raise ValueError(f"{card.where}: TLOAD1 {card.text(1)} is read with a number for its delay, not DELAY.")
        history = ("table", card.whole(5), card.number(3, 0.0))
        self._histories[history] = self._table(card)
        excite = card.whole(2)
        for sequence in self._deck.named("LSEQ"):
            if sequence.whole(2) == excite:
                self.static(sequence.whole(3), history)
                return
        areas = [area for area in self._deck.named("DAREA") if area.whole(1) == excite]
        for area in areas:
            for at in (2, 5):
                if area.text(at):
                    self._area(area, at, factor, history)
        if not areas or any(c.whole(1) == excite for c in self._deck.named("LOAD", *STATIC, *BEYOND)):
            for scale, number in self._combined("LOAD", excite):
                for load in self._deck.named(*STATIC):
                    if load.whole(1) == number:
                        self._add(load, factor * scale, history)

    def _area(self, card: Card, at: int, factor: float, history: Any) -> None:
        target, nodes = self._geometry.nodes([card.whole(at)], False, card)
        component, value = card.whole(at + 1), factor * card.number(at + 2)
        if not nodes.size:
            self._notes.missing.append(f"{card} on a grid point of no shell")
        else:
            self._check_system([card.whole(at)], str(component), card, moved=True)
            vector = np.zeros(3)
            vector[(component - 1) % 3] = value
            self._forces.add("force" if component <= 3 else "moment", target, vector, history)
            self._notes.carried["nodal forces and moments"] += 1

    def _table(self, load: Card) -> dict[str, Any]:
        """The history of a TABLED1, moved on by the load's delay."""
        number, delay = load.whole(5), load.number(3, 0.0)
        card = next((card for card in self._deck.named("TABLED1") if card.whole(1) == number), None)
        if card is None:
            raise ValueError(f"{load.where}: TLOAD1 {load.text(1)} names TABLED1 {number}, which there is not.")
        if "LOG" in (card.text(2).upper(), card.text(3).upper()):
            raise ValueError(f"{card.where}: TABLED1 {number} is read with linear axes only.")
        entries = [text for text in card.fields[8:] if text]
        if "ENDT" in map(str.upper, entries):
            entries = entries[: [text.upper() for text in entries].index("ENDT")]
        values = [Card(card.name, [text], card.where).number(1) for text in entries if text.upper() != "SKIP"]
        times, factors = [time + delay for time in values[::2]], values[1::2]
        if len(times) < 2 or len(times) != len(factors) or any(b <= a for a, b in pairwise(times)):
            raise ValueError(f"{card.where}: the times of TABLED1 {number} must increase, each with a value.")
        if times[-1] < self._end and factors[-1] != factors[-2]:
            slope = (factors[-1] - factors[-2]) / (times[-1] - times[-2])
            factors.append(factors[-1] + slope * (self._end - times[-1]))
            times.append(self._end)
        if times[0] > delay and factors[0] != factors[1]:
            slope = (factors[1] - factors[0]) / (times[1] - times[0])
            factors.insert(0, factors[0] + slope * (delay - times[0]))
            times.insert(0, delay)
        if delay > 0 and factors[0] != 0.0:
            raise ValueError(
                f"{load.where}: TLOAD1 {load.text(1)} jumps from 0 after its delay, which no history does."
            )
        self._notes.carried["load histories"] += 1
        return {"times": times, "values": factors}

    def _combined(self, kind: str, number: int) -> list[tuple[float, int]]:
        """(factor, number) of the loads that a LOAD or DLOAD card adds up; of one without such a card itself."""
        for card in self._deck.named(kind):
            if card.whole(1) == number:
                whole = card.number(2)
                pairs = range(3, len(card.fields) + 1, 2)
                return [(whole * card.number(at), card.whole(at + 1)) for at in pairs if card.text(at)]
        return [(1.0, number)]

    def _add(self, card: Card, factor: float, history: Any) -> None:
        if card.name in ("FORCE", "MOMENT"):
            system = self._geometry.systems.system(card.whole(3, 0), card)
            vector = factor * card.number(4) * system.vector(card.vector(5), card)
            target, nodes = self._geometry.nodes([card.whole(2)], False, card)
            if not nodes.size:
                self._notes.missing.append(f"{card.name} on GRID {card.text(2)}, of no shell ({card.where})")
                return
            self._forces.add(card.name.lower(), target, vector, history)
            self._notes.carried["nodal forces and moments"] += 1
        elif card.name == "GRAV":
            system = self._geometry.systems.system(card.whole(2, 0), card)
            vector = factor * card.number(3) * system.vector(card.vector(4), card)
            self._shell({"kind": "gravity", "acceleration": vector.tolist()}, history, "gravity")
        else:
            self._pressure(card, factor, history)

    def _pressure(self, card: Card, factor: float, history: Any) -> None:
        """PLOAD2 and PLOAD4, positive along the elements' normals."""
        if card.name == "PLOAD2":
            value, labels = card.number(2), card.labels(3)[0]
        else:
            value, labels = card.number(3), [card.whole(2)]
            corners = [card.number(at, value) for at in (4, 5, 6) if card.text(at)]
            if any(corner != value for corner in corners if corner) or (0.0 in corners and value):
                raise ValueError(f"{card.where}: PLOAD4 {card.text(1)} is read with one pressure at all corners.")
            if card.text(7).upper() == "THRU" or (card.text(8) and not card.text(7)):
                labels = list(range(labels[0], card.whole(8) + 1))
            if any(card.number(at, 0.0) for at in (10, 11, 12)):
                self._notes.missing.append(f"PLOAD4 with a direction of its own ({card.where})")
                return
            kind = tuple(card.text(at).upper() for at in (13, 14))
            if kind[0] not in ("", "SURF") or kind[1] not in ("", "NORM"):
                self._notes.missing.append(f"PLOAD4 of type {', '.join(filter(None, kind))} ({card.where})")
                return
        triangles = self._geometry.triangles(labels)
        strange = [label for label in labels if not self._geometry.is_shell(label)]
        if not triangles.size or (strange and len(labels) == 1):
            self._notes.missing.append(f"{card.name} on element {labels[0]}, which is no shell ({card.where})")
            return
        table: dict[str, Any] = {"kind": "pressure"}
        if triangles.size < self._geometry.mesh.n_elements:
            table["elements"] = self._geometry.named(triangles)
        self._shell({**table, "pressure": factor * value}, history, "pressures")

    def _shell(self, table: dict[str, Any], history: Any, what: str) -> None:
        """A load on elements; one like it, on other elements, takes them in."""
        table = with_history(table, self._histories[history])
        self._notes.carried[what] += 1
        for other in self._on_shell:
            one, two = other.get("elements"), table.get("elements")
            if not isinstance(one, list) or not isinstance(two, list) or set(one) & set(two):
                continue
            if {**other, "elements": None} == {**table, "elements": None}:
                joined = np.array(sorted(one + two))
                whole = joined.size == self._geometry.mesh.n_elements
                other.pop("elements") if whole else other.update(elements=self._geometry.named(joined))
                return
        self._on_shell.append(table)
