"""Supports, loads, amplitudes and initial velocities of an input file, as tables of a scene file.

Where a load or a motion names no *AMPLITUDE, it has the step's: a ramp over a static step, and whole from the start of
a dynamic one, as in Abaqus; AMPLITUDE= of *STEP says otherwise.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from jaxshell.files.abaqus.geometry import Geometry, Scope
from jaxshell.files.draft import Forces, Holds, Notes, Target, with_history
from jaxshell.model.mesh_files.cards import Card, Line

_NAMED = {
    "ENCASTRE": range(6),
    "PINNED": range(3),
    "XSYMM": (0, 4, 5),
    "YSYMM": (1, 3, 5),
    "ZSYMM": (2, 3, 4),
    "XASYMM": (1, 2, 3),
    "YASYMM": (0, 2, 4),
    "ZASYMM": (0, 1, 5),
}
STEP = "of the step"
"""The name of the amplitude that the step gives."""


class Loads:
    """What acts on the shell. `default` is the step's amplitude, as the table of a history or None for 1 throughout;
    `statics` says that loads act in proportion, whatever their histories."""

    def __init__(self, geometry: Geometry, notes: Notes, default: dict[str, Any] | None, end: float, statics: bool):
        self._geometry, self._notes, self._end, self._statics = geometry, notes, end, statics
        self._histories: dict[Any, dict[str, Any] | None] = {STEP: default}
        self._finals: dict[str, float] = {}
        self._holds, self._forces = Holds(), Forces()
        self._on_shell: list[dict[str, Any]] = []
        self._heat: list[dict[str, Any]] = []
        self._initial: dict[tuple[Target, tuple[int, ...]], np.ndarray] = {}
        self._temperature = 0.0

    def tables(self) -> dict[str, Any]:
        """[[supports]], [[loads]], [[thermal]], [[initial]]."""
        found = {
            "supports": self._holds.tables(self._histories),
            "loads": self._forces.tables(self._histories) + self._on_shell,
            "thermal": self._heat,
            "initial": self._velocities(),
        }
        return {key: value for key, value in found.items() if value}

    def _velocities(self) -> list[dict[str, Any]]:
        """[[initial]]: by the names of the sets where no node is in two of them, else the nodes of each velocity."""
        each, owners = np.zeros((self._geometry.mesh.n_nodes, 3)), np.zeros(self._geometry.mesh.n_nodes, int)
        for (_, nodes), velocity in self._initial.items():
            given = ~np.isnan(velocity)
            each[list(nodes)] = np.where(given, velocity, each[list(nodes)])
            owners[list(nodes)] += 1
        if owners.max(initial=0) < 2:
            return [
                {"nodes": target if isinstance(target, str) else list(target), "velocity": np.nan_to_num(v).tolist()}
                for (target, _), v in self._initial.items()
            ]
        alike: dict[tuple[float, ...], list[int]] = {}
        for node in np.flatnonzero(owners).tolist():
            alike.setdefault(tuple(each[node].tolist()), []).append(node)
        return [{"nodes": nodes, "velocity": list(velocity)} for velocity, nodes in alike.items()]

    # --- amplitudes --------------------------------------------------------------------------------------

    def amplitude(self, card: Card) -> None:
        """*AMPLITUDE. Raises ValueError for kinds that are no tables, and for times that do not increase."""
        name, kind = card.option("NAME"), card.choice("DEFINITION", "TABULAR")
        if kind not in ("TABULAR", "EQUALLY SPACED") or card.choice("VALUE", "RELATIVE") != "RELATIVE":
            raise ValueError(
                f"{card.where}: *AMPLITUDE {name} is read with DEFINITION=TABULAR or EQUALLY SPACED and VALUE=RELATIVE "
                "only: tabulate it."
            )
        if card.value("SMOOTH"):
            self._notes.left_out.append(f"SMOOTH={card.options['SMOOTH']} of *AMPLITUDE {name} ({card.where})")
        numbers = [line.number(i) for line in card.lines for i, text in enumerate(line.fields) if text]
        if kind == "TABULAR":
            times, values = numbers[::2], numbers[1::2]
        else:
            interval, begin = card.value("FIXEDINTERVAL"), card.value("BEGIN")
            times, values = [begin + interval * i for i in range(len(numbers))], numbers
        if not times or len(times) != len(values) or any(b <= a for a, b in pairwise(times)):
            raise ValueError(f"{card.where}: the times of *AMPLITUDE {name} must increase, each with a value.")
        self._histories[name.upper()] = {"times": times, "values": values}
        self._notes.carried["amplitudes"] += 1

    def _history(self, card: Card) -> str:
        name = card.options.get("AMPLITUDE")
        if not name:
            return STEP
        if name.upper() not in self._histories:
            raise ValueError(f"{card.where}: there is no *AMPLITUDE {name}.")
        return name.upper()

    def _scale(self, card: Card) -> float:
        """In statics, which goes by the load factor, the amplitude's value at the end of the step; else 1."""
        history = self._histories[self._history(card)]
        if not self._statics or self._history(card) == STEP or history is None:
            return 1.0
        final = float(np.interp(self._end, history["times"], history["values"]))
        if history["values"][0] != 0.0 or len(history["times"]) > 2:
            self._notes.remarks.append(
                f"the course of AMPLITUDE={card.options['AMPLITUDE']} of {card}: statics applies all loads in "
                "proportion, up to what they are at the end of the step"
            )
        if not final:
            raise ValueError(f"{card.where}: AMPLITUDE={card.options['AMPLITUDE']} is 0 at the end of the step.")
        self._histories[self._history(card), "statics"] = {"ramp": self._end}
        return final

    def _course(self, card: Card) -> tuple[Any, float]:
        """(the history's name, a factor of the load)."""
        scale = self._scale(card)
        name = self._history(card)
        return (name, "statics") if (name, "statics") in self._histories else name, scale

    # --- supports ----------------------------------------------------------------------------------------

    def boundary(self, card: Card, scope: Scope, in_step: bool) -> None:
        """*BOUNDARY, of the model or of the step."""
        if card.choice("TYPE", "DISPLACEMENT") != "DISPLACEMENT":
            self._notes.missing.append(f"{card.title}, TYPE={card.options['TYPE']} ({card.where})")
            return
        for line in card.lines:
            self._boundary_line(card, line, scope, in_step)
            self._notes.carried["supports"] += 1

    def _boundary_line(self, card: Card, line: Line, scope: Scope, in_step: bool) -> None:
        target, nodes = self._nodes(line, scope, f"*BOUNDARY ({line.where})", held=True)
        if not nodes.size:
            return
        named = line.text(1).upper()
        if named in _NAMED:
            self._holds.hold(target, nodes, _NAMED[named])
            return
        first = line.whole(1)
        last = line.whole(2, first)
        if not 1 <= first <= last <= 6:
            raise ValueError(f"{line.where}: degrees of freedom are 1 to 6 here, but they are {first} to {last}.")
        value = line.number(3, 0.0) if in_step else 0.0
        if not value:
            self._holds.hold(target, nodes, range(first - 1, last))
            return
        if last > 3:
            self._notes.missing.append(f"*BOUNDARY ({line.where}): prescribed rotations of {line.text(0)}")
            return
        history, scale = self._course(card)
        table = self._histories[history]
        if table is None or ("values" in table and np.interp(0.0, table["times"], table["values"]) != 0.0):
            raise ValueError(
                f"{line.where}: the displacement of {line.text(0)} jumps at the start of the step; give *BOUNDARY an "
                "AMPLITUDE that starts from 0."
            )
        for dof in range(first - 1, last):
            self._holds.move(target, nodes, dof, scale * value, history)

    def _nodes(self, line: Line, scope: Scope, what: str, held: bool = False) -> tuple[Target, np.ndarray]:
        """Of the first field; a line of the notes where no shell element has them."""
        target, nodes = self._geometry.nodes(line.text(0), scope, line.where)
        if not nodes.size:
            notes = self._notes.left_out if held else self._notes.missing
            notes.append(f"{what}: no shell element has a node of {line.text(0)}")
        return target, nodes

    # --- loads -------------------------------------------------------------------------------------------

    def concentrated(self, card: Card, scope: Scope) -> None:
        """*CLOAD; with FOLLOWER forces that turn with their nodes."""
        turns = "FOLLOWER" in card.options
        history, scale = self._course(card)
        for line in card.lines:
            target, nodes = self._nodes(line, scope, f"*CLOAD ({line.where})")
            dof = line.whole(1)
            if not 1 <= dof <= 6:
                raise ValueError(f"{line.where}: degrees of freedom are 1 to 6 here, but it is {dof}.")
            if turns and dof > 3:
                self._notes.missing.append(f"*CLOAD, FOLLOWER of degree of freedom {dof} ({line.where})")
            elif nodes.size:
                vector = np.zeros(3)
                vector[(dof - 1) % 3] = scale * line.number(2)
                kind = "follower force" if turns else "force" if dof <= 3 else "moment"
                self._forces.add(kind, target, vector, history)
                self._notes.carried["nodal forces and moments"] += 1

    def distributed(self, card: Card, scope: Scope) -> None:
        """*DLOAD: pressure along the elements' normals, that of a liquid, tractions that do not turn, and gravity."""
        history, scale = self._course(card)
        for line in card.lines:
            kind = line.text(1).upper()
            every = tuple(range(self._geometry.mesh.n_elements))
            target, elements = (
                self._geometry.elements(line.text(0), scope, line.where) if line.text(0) else (every, np.array(every))
            )
            if kind in ("P", "HP", "TRVEC"):
                self._on_elements(card, line, (target, elements, 1.0), scale, history)
            elif kind == "GRAV":
                self._gravity(line, (target, elements), scale, history)
            else:
                self._notes.missing.append(f"{card.title} of type {kind} ({line.where})")

    def on_surface(self, card: Card, scope: Scope) -> None:
        """*DSLOAD: a pressure pushes onto the side that the surface is, against its normal."""
        history, scale = self._course(card)
        for line in card.lines:
            if line.text(1).upper() not in ("P", "HP", "TRVEC"):
                self._notes.missing.append(f"*DSLOAD of type {line.text(1)} ({line.where})")
                continue
            for target, elements, side in self._geometry.surface(line.text(0), scope, line.where):
                if side not in ("SPOS", "SNEG"):
                    raise ValueError(f"{line.where}: surface {line.text(0)} has the side {side!r}, not SPOS or SNEG.")
                sign = -1.0 if side == "SPOS" else 1.0
                self._on_elements(card, line, (target, elements, sign), scale, history)

    def _on_elements(
        self, card: Card, line: Line, on: tuple[Target, np.ndarray, float], scale: float, history: Any
    ) -> None:
        """P, HP or TRVEC; `on` is (target, its elements, the sign of what pushes along their normals)."""
        target, elements, sign = on
        kind, value = line.text(1).upper(), scale * line.number(2)
        if not elements.size or not value:
            return
        table: dict[str, Any] = {"kind": "pressure", "pressure": sign * value}
        if kind == "HP":
            level, point = line.number(3), line.number(4)
            if level == point:
                raise ValueError(f"{line.where}: HP needs its pressure at another height than that where it is zero.")
            table = {"kind": "hydrostatic pressure", "weight": sign * value / (level - point), "level": level}
        elif kind == "TRVEC":
            fixed = card.choice("FOLLOWER", "YES") == "NO" and card.choice("CONSTANTRESULTANT", "NO") == "YES"
            if not fixed or "ORIENTATION" in card.options:
                self._notes.missing.append(
                    f"{card.title} of type TRVEC ({line.where}), which is carried over with FOLLOWER=NO, CONSTANT "
                    "RESULTANT=YES and without ORIENTATION"
                )
                return
            table = {"kind": "traction", "traction": (value * _direction(line)).tolist()}
        self._add_on(target, elements, table, history, "pressures" if kind == "P" else f"loads of type {kind}")

    def _gravity(self, line: Line, on: tuple[Target, np.ndarray], scale: float, history: Any) -> None:
        vector = scale * line.number(2) * _direction(line)
        self._add_on(*on, {"kind": "gravity", "acceleration": vector.tolist()}, history, "gravity")

    def _add_on(self, target: Target, elements: np.ndarray, table: dict[str, Any], history: Any, what: str) -> None:
        if elements.size < self._geometry.mesh.n_elements:
            table["elements"] = target if isinstance(target, str) else list(target)
        self._on_shell.append(with_history(table, self._histories[history]))
        self._notes.carried[what] += 1

    # --- heat and velocities -----------------------------------------------------------------------------

    def initial(self, card: Card, scope: Scope) -> None:
        """*INITIAL CONDITIONS of velocities, and of one temperature for all."""
        kind = card.choice("TYPE", "")
        if kind == "TEMPERATURE":
            self._temperature = self._uniform(card, scope)[0]
        elif kind != "VELOCITY":
            self._notes.missing.append(f"{card.title}, TYPE={kind} ({card.where})")
        else:
            for line in card.lines:
                target, nodes = self._nodes(line, scope, f"{card.title} ({line.where})")
                dof = line.whole(1)
                if not 1 <= dof <= 3:
                    self._notes.missing.append(f"initial velocity of degree of freedom {dof} ({line.where})")
                elif nodes.size:
                    key = target, tuple(nodes.tolist())
                    self._initial.setdefault(key, np.full(3, np.nan))[dof - 1] = line.number(2)
                    self._notes.carried["initial velocities"] += 1

    def heat(self, card: Card, scope: Scope) -> None:
        """*TEMPERATURE that is the same for all nodes, against the initial one."""
        if not card.lines:
            raise ValueError(f"{card.where}: *TEMPERATURE from a result file is not read.")
        temperature, gradient = self._uniform(card, scope)
        history, scale = self._course(card)
        if scale != 1.0 and self._temperature:
            raise ValueError(f"{card.where}: *TEMPERATURE from an initial one is read without AMPLITUDE only.")
        table = {"temperature": scale * temperature - self._temperature}
        if gradient:
            table["gradient"] = scale * gradient
        self._heat.append(with_history(table, self._histories[history]))
        self._notes.carried["temperatures"] += 1

    def _uniform(self, card: Card, scope: Scope) -> tuple[float, float]:
        """(temperature, gradient) that all nodes of the shell have. Raises ValueError where they differ."""
        seen, values = np.zeros(self._geometry.mesh.n_nodes, bool), set()
        for line in card.lines:
            _, nodes = self._geometry.nodes(line.text(0), scope, line.where)
            seen[nodes] = True
            if nodes.size:
                values.add((line.number(1), line.number(2, 0.0)))
        if len(values) != 1 or not seen.all():
            raise ValueError(f"{card.where}: {card.title} is read where all nodes of the shell have one temperature.")
        return values.pop()


def _direction(line: Line) -> np.ndarray:
    """The unit vector of the fields after the magnitude. Raises ValueError for one of no length."""
    direction = np.array([line.number(i, 0.0) for i in (3, 4, 5)])
    size = np.linalg.norm(direction)
    if not size > 0:
        raise ValueError(f"{line.where}: {line.text(1).upper()} needs a direction.")
    return direction / size
