"""*SHELL SECTION and *SHELL GENERAL SECTION, as tables [section] or [[section]] of a scene file."""

from typing import Any

import numpy as np

from jaxshell.files.abaqus.geometry import Geometry, Scope
from jaxshell.files.abaqus.materials import Material, expansion_fits
from jaxshell.files.abaqus.orientations import Orientation, angle_between, default_direction
from jaxshell.files.draft import Notes
from jaxshell.model.mesh_files.cards import Card, Line

SECTIONS = ("SHELLSECTION", "SHELLGENERALSECTION")


class Sections:
    """The sections of a file. `statics` says whether densities may be missing."""

    def __init__(
        self,
        geometry: Geometry,
        materials: dict[str, Material],
        orientations: dict[tuple[str, str], Orientation],
        notes: Notes,
        statics: bool,
    ):
        self._geometry, self._materials, self._orientations = geometry, materials, orientations
        self._notes, self._statics = notes, statics
        self._x = np.asarray(geometry.mesh.nodes)[geometry.mesh.triangles]
        self._tables: list[dict[str, Any]] = []
        self._elements: list[np.ndarray] = []
        self._damping: dict[str, np.ndarray] = {}
        self.used: dict[str, dict[str, Any]] = {}
        """[materials] that a laminate names."""

    def add(self, card: Card, scope: Scope) -> None:
        """The section of a card. Raises ValueError naming its line."""
        target, elements = self._geometry.elements(card.option("ELSET"), scope, card.where)
        if not elements.size:
            self._notes.left_out.append(f"{card}: its set {card.options['ELSET']} has no shell elements")
            return
        if "NODALTHICKNESS" in card.options or "STACKDIRECTION" in card.options:
            raise ValueError(f"{card.where}: {card.title} is not read with NODAL THICKNESS or STACK DIRECTION.")
        if "COMPOSITE" in card.options:
            table = self._composite(card, scope, elements)
        elif "MATERIAL" in card.options:
            table = self._homogeneous(card, scope, elements)
        elif card.keyword == "SHELLGENERALSECTION":
            table = self._general(card, scope, elements)
        else:
            raise ValueError(f"{card.where}: {card.title} needs MATERIAL= or COMPOSITE.")
        where = target if isinstance(target, str) else list(target)
        self._tables.append({"elements": where, **table})
        self._elements.append(elements)
        self._notes.carried["sections"] += 1

    def tables(self) -> dict[str, Any]:
        """[section] or [[section]], [materials.X] and [damping]. Raises ValueError for elements without a section."""
        self._check_whole()
        found: dict[str, Any] = {}
        if self.used:
            found["materials"] = self.used
        if len(self._tables) == 1:
            found["section"] = {key: value for key, value in self._tables[0].items() if key != "elements"}
        else:
            found["section"] = self._tables
        damping = {key: _one_or_each(values) for key, values in self._damping.items()}
        return {**found, "damping": damping} if damping else found

    def _check_whole(self) -> None:
        owner = np.zeros(self._geometry.mesh.n_elements, int)
        for elements in self._elements:
            owner[elements] += 1
        for count, what in ((0, "has no *SHELL SECTION"), (2, "has more than one *SHELL SECTION")):
            bad = np.flatnonzero(owner == 0 if count == 0 else owner >= count)
            if bad.size:
                label = self._geometry.label(int(bad[0]))
                raise ValueError(f"Element {label} {what} ({bad.size} triangles of {owner.size} in all).")

    def _homogeneous(self, card: Card, scope: Scope, elements: np.ndarray) -> dict[str, Any]:
        material = self._material(card.option("MATERIAL"), card.where)
        thickness = card.line(0).number(0)
        offset = _offset(card, thickness)
        values = self._values(material)
        self._damp(material, elements)
        if material.is_isotropic and not offset:
            return {"thickness": thickness, **values}
        ply = {"material": self._name(material), "thickness": thickness}
        return self._laminate([ply], offset, self._direction(card, scope, elements), False)

    def _composite(self, card: Card, scope: Scope, elements: np.ndarray) -> dict[str, Any]:
        direction = self._direction(card, scope, elements)
        lines = [line for line in card.lines if any(line.fields)]
        if not lines:
            raise ValueError(f"{card.where}: {card.title}, COMPOSITE has no plies.")
        plies, dampings = [], []
        for line in lines:
            material = self._material(line.text(2) or card.options.get("MATERIAL", ""), line.where)
            dampings.append(material.damping)
            plies.append({"material": self._name(material), "thickness": line.number(0)})
            plies[-1]["angle"] = self._angle(line, scope, elements, direction)
            self._values(material)
        if any(damping != dampings[0] for damping in dampings):
            self._notes.missing.append(f"*DAMPING of the plies of {card}, whose materials are damped differently")
        else:
            self._damp(self._material(lines[0].text(2) or card.options.get("MATERIAL", ""), card.where), elements)
        symmetric = "SYMMETRIC" in card.options
        whole = sum(ply["thickness"] for ply in plies) * (2 if symmetric else 1)
        return self._laminate(plies, _offset(card, whole), direction, symmetric)

    def _general(self, card: Card, scope: Scope, elements: np.ndarray) -> dict[str, Any]:
        numbers = [value for line in card.lines for value in line.numbers()]
        if len(numbers) < 21 or "ZERO" in card.options:
            raise ValueError(
                f"{card.where}: {card.title} needs MATERIAL=, COMPOSITE, or the 21 stiffnesses of a section."
            )
        whole = np.zeros((6, 6))
        rows, columns = zip(*((i, j) for j in range(6) for i in range(j + 1)), strict=True)
        whole[rows, columns] = whole[columns, rows] = numbers[:21]
        density = card.value("DENSITY")
        if not density:
            if not self._statics:
                raise ValueError(f"{card.where}: {card.title} has no DENSITY=, which motion needs.")
            self._notes.remarks.append(f"{card} has no DENSITY=: a mass per area of 1.0 stands in its place")
        A, B, D = whole[:3, :3], whole[:3, 3:], whole[3:, 3:]
        if np.abs(B - B.T).max() > 1e-9 * np.abs(whole).max():
            raise ValueError(f"{card.where}: the coupling of membrane and bending must be symmetric.")
        return {
            "kind": "general",
            "A": A.tolist(),
            "B": B.tolist(),
            "D": D.tolist(),
            "mass_per_area": density or 1.0,
            "direction": self._direction(card, scope, elements),
        }

    def _laminate(self, plies: list, offset: float, direction, symmetric: bool) -> dict[str, Any]:
        return {
            "kind": "laminate",
            "direction": direction,
            **({"offset": offset} if offset else {}),
            **({"symmetric": True} if symmetric else {}),
            "plies": plies,
        }

    def _angle(self, line: Line, scope: Scope, elements: np.ndarray, direction) -> float | list[float]:
        """Of a ply, from the laminate's direction on."""
        text = line.text(3)
        try:
            return float(text or 0.0)
        except ValueError:
            vectors = self._orientation(text, scope, line.where).vectors(self._centres(elements))
        if isinstance(direction, dict):
            named = self._orientation_of(direction)
            first = named.vectors(self._centres(elements))
        else:
            first = np.broadcast_to(np.array(direction, float), (len(elements), 3))
        angles = angle_between(self._x[elements], first, vectors)
        return _one_or_each(np.where(np.abs(angles) < 1e-12, 0.0, angles))

    def _direction(self, card: Card, scope: Scope, elements: np.ndarray) -> Any:
        name = card.options.get("ORIENTATION")
        if not name:
            return default_direction(self._x[elements])
        orientation = self._orientation(name, scope, card.where)
        direction = orientation.direction()
        return orientation.vectors(self._centres(elements)).tolist() if direction is None else direction

    def _centres(self, elements: np.ndarray) -> np.ndarray:
        return self._x[elements].mean(axis=1)

    def _orientation_of(self, direction: dict) -> Orientation:
        return next(o for o in self._orientations.values() if o.direction() == direction)

    def _orientation(self, name: str, scope: Scope, where: str) -> Orientation:
        for key in ((scope.name, name.upper()), ("", name.upper())):
            if key in self._orientations:
                return self._orientations[key]
        raise ValueError(f"{where}: there is no *ORIENTATION {name}.")

    def _material(self, name: str, where: str) -> Material:
        if name.strip("\"'").upper() not in self._materials:
            known = ", ".join(material.name for material in self._materials.values()) or "none"
            raise ValueError(f"{where}: there is no *MATERIAL {name or '(no name)'}; those of the file: {known}.")
        return self._materials[name.strip("\"'").upper()]

    def _values(self, material: Material) -> dict[str, Any]:
        try:
            return expansion_fits(material.table(self._statics, self._notes))
        except ValueError as error:
            raise ValueError(f"Material {material.name}: {error}") from error

    def _name(self, material: Material) -> str:
        self.used[material.name] = self._values(material)
        return material.name

    def _damp(self, material: Material, elements: np.ndarray) -> None:
        for key, value in material.damping.items():
            if value:
                each = self._damping.setdefault(key, np.zeros(self._geometry.mesh.n_elements))
                each[elements] = value


def _one_or_each(values: np.ndarray) -> float | list[float]:
    """One number where all are the same, but for round-off."""
    return float(values[0]) if np.ptp(values) <= 1e-12 * max(1.0, np.abs(values).max()) else values.tolist()


def _offset(card: Card, thickness: float) -> float:
    """z of the middle surface from the nodes, which lie OFFSET times the thickness above it (CalculiX as Abaqus)."""
    text = card.options.get("OFFSET", "0").upper()
    try:
        fraction = {"SPOS": 0.5, "SNEG": -0.5}[text] if text in ("SPOS", "SNEG") else float(text)
    except ValueError:
        raise ValueError(f"{card.where}: OFFSET={text} should be a number, SPOS or SNEG.") from None
    return -fraction * thickness
