"""An Abaqus or CalculiX input file as a draft of a scene: what each card becomes, and which have no counterpart."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxshell.files.abaqus.geometry import Geometry, Scope, beside_the_mesh
from jaxshell.files.abaqus.loads import Loads
from jaxshell.files.abaqus.masses import MASSES, Masses
from jaxshell.files.abaqus.materials import IN_MATERIALS, Material, add, is_beyond
from jaxshell.files.abaqus.orientations import Orientation
from jaxshell.files.abaqus.sections import SECTIONS, Sections
from jaxshell.files.draft import Draft, Notes
from jaxshell.model.mesh_files.cards import Card, read_cards

_OUTPUT = (
    "NODEPRINT", "NODEFILE", "ELPRINT", "ELFILE", "ENERGYPRINT", "ENERGYFILE", "MODALFILE", "NODEOUTPUT",
    "ELEMENTOUTPUT", "ENERGYOUTPUT", "OUTPUT", "FILEFORMAT", "RESTART", "MONITOR", "PRINT", "SECTIONPRINT",
    "INTEGRATEDOUTPUT", "CONTACTOUTPUT", "CONTACTFILE", "CONTACTPRINT", "INCREMENTATIONOUTPUT", "FILTER", "MODALOUTPUT",
)  # fmt: skip
"""Requests of results."""
_SILENT = ("HEADING", "PREPRINT", "ENDSTEP", "STEP", "NOMAP")
"""Cards without physics."""
_STRUCTURAL = (
    "NONSTRUCTURALMASS", "RIGIDBODY", "MPC", "EQUATION", "TIE", "COUPLING", "KINEMATIC",
    "DISTRIBUTING", "KINEMATICCOUPLING", "DISTRIBUTINGCOUPLING", "SPRING", "DASHPOT", "CONNECTORSECTION", "FASTENER",
    "BEAMSECTION", "BEAMGENERALSECTION", "SOLIDSECTION", "MEMBRANESECTION", "TRANSFORM", "CONTACT", "CONTACTPAIR",
    "CONTACTINCLUSIONS", "SHELLTOSOLIDCOUPLING", "EMBEDDEDELEMENT", "FOUNDATION", "REBARLAYER", "GAP", "DISPLAYBODY",
    "PRETENSIONSECTION", "CYCLICSYMMETRYMODEL", "IMPERFECTION", "INITIALSTRAINRATES", "INERTIARELIEF", "FILM",
    "RADIATE", "DFLUX", "CFLUX", "BASEMOTION", "MODELCHANGE", "FLUIDCAVITY", "RELEASE", "SHELLTHICKNESS",
    "NODALTHICKNESS", "DISTRIBUTION", "SUBSTRUCTUREGENERATE", "SUBMODEL",
)  # fmt: skip
"""Cards without which the answer is another."""
_PROCEDURES = ("STATIC", "DYNAMIC", "FREQUENCY", "BUCKLE")


@dataclass
class _Step:
    """The first step: its settings of [run], its duration, and whether it is statics."""

    run: dict[str, Any]
    period: float
    statics: bool
    ramps: bool


def read_abaqus(path: Path, second_order: str) -> Draft:
    """The draft of an input file. Raises FileNotFoundError, and ValueError with file and line for what is wrong."""
    notes = Notes()
    cards = read_cards(path)
    geometry = Geometry(cards, str(path), notes, second_order)
    in_model, in_step = _parted(beside_the_mesh(cards), notes)
    step = _step(in_step, notes)
    materials, orientations = _properties(in_model, notes)
    sections = Sections(geometry, materials, orientations, notes, step.statics)
    default = {"ramp": step.period} if step.ramps else None
    loads = Loads(geometry, notes, default, step.period, step.statics)
    for card, scope in in_model + in_step:  # amplitudes stand anywhere
        if card.keyword == "AMPLITUDE":
            loads.amplitude(card)
    masses = Masses(geometry, notes)
    for position, (card, scope) in enumerate(in_model + in_step):
        if card.keyword in MASSES:
            masses.add(card, scope)
        else:
            _carry(card, scope, sections, loads, notes, position >= len(in_model))
    tables = {**sections.tables(), **loads.tables(), **masses.tables()}
    damping = tables.pop("damping", None)
    if damping is not None:
        tables["damping"] = damping
    notes.carried["materials"] += len(materials)
    return Draft(Path(path), geometry.mesh, {"name": Path(path).stem, **tables, "run": step.run}, notes)


def _parted(rest: list[tuple[Card, Scope]], notes: Notes) -> tuple[list, list]:
    """Cards of the model, and of the first step; a note for each step after it."""
    in_model, in_step, steps = [], [], 0
    for card, scope in rest:
        if card.keyword == "STEP":
            steps += 1
            if steps > 1:
                notes.left_out.append(f"step {steps} ({card.where}): only the first step is carried over")
        if steps <= 1:
            (in_step if steps else in_model).append((card, scope))
    outputs = [card for card, _ in in_model + in_step if card.keyword in _OUTPUT]
    if outputs:
        titles = ", ".join(dict.fromkeys(card.title for card in outputs))
        notes.left_out.append(f"output requests: {titles}")
    return in_model, in_step


def _properties(cards: list, notes: Notes) -> tuple[dict[str, Material], dict[tuple[str, str], Orientation]]:
    """Materials and orientations by their names in capitals."""
    materials: dict[str, Material] = {}
    orientations = {}
    current: Material | None = None
    for card, scope in cards:
        if card.keyword == "MATERIAL":
            current = Material(card.option("NAME"), card.where)
            materials[current.name.upper()] = current
        elif card.keyword == "ORIENTATION":
            orientations[scope.name, card.option("NAME").upper()] = Orientation(card, scope)
        elif card.keyword in IN_MATERIALS and current is not None:
            add(current, card, notes)
        elif is_beyond(card):
            name = current.name if current else "?"
            notes.missing.append(f"{card.title} of material {name} ({card.where}): jaxshell is linear elastic")
    return materials, orientations


def _carry(card: Card, scope: Scope, sections: Sections, loads: Loads, notes: Notes, in_step: bool) -> None:
    key = card.keyword
    if key in SECTIONS:
        sections.add(card, scope)
    elif key == "BOUNDARY":
        loads.boundary(card, scope, in_step)
    elif key == "CLOAD":
        loads.concentrated(card, scope)
    elif key == "DLOAD":
        loads.distributed(card, scope)
    elif key == "DSLOAD":
        loads.on_surface(card, scope)
    elif key == "TEMPERATURE":
        loads.heat(card, scope)
    elif key == "INITIALCONDITIONS":
        loads.initial(card, scope)
    elif key in _STRUCTURAL:
        notes.missing.append(str(card))
    elif not (key in (*_OUTPUT, *_SILENT, *_PROCEDURES, *IN_MATERIALS) or is_beyond(card)) and key not in (
        "MATERIAL",
        "ORIENTATION",
        "AMPLITUDE",
    ):
        notes.left_out.append(f"{card}: not known here")


def _step(cards: list, notes: Notes) -> _Step:
    """The settings of the first step; without one, those of a run in time that lacks dt and t_end."""
    if not cards:
        notes.remarks.append("the file has no *STEP: [run] lacks dt and t_end")
        return _Step({}, 1.0, False, False)
    step = cards[0][0]
    found = next((card for card, _ in cards if card.keyword in _PROCEDURES), None)
    if found is None:
        raise ValueError(f"{step.where}: the first *STEP has none of *STATIC, *DYNAMIC, *FREQUENCY, *BUCKLE.")
    linear = step.choice("NLGEOM", "NO") == "NO" and "NLGEOM" not in step.options
    if found.keyword in ("STATIC", "DYNAMIC") and (linear or step.options.get("NLGEOM", "").upper() == "NO"):
        notes.remarks.append(f"{step}: it is geometrically linear, and jaxshell turns and moves by finite amounts")
    made = {"STATIC": _static, "DYNAMIC": _dynamic, "FREQUENCY": _modes, "BUCKLE": _buckling}[found.keyword](
        found, notes
    )
    amplitude = step.choice("AMPLITUDE", "RAMP" if made.ramps else "STEP")
    made.ramps = amplitude == "RAMP"
    notes.carried[found.title] += 1
    return made


def _static(card: Card, notes: Notes) -> _Step:
    first = card.lines[0] if card.lines else None
    dt, period = (first.number(0, 1.0), first.number(1, 1.0)) if first else (1.0, 1.0)
    run: dict[str, Any] = {"analysis": "static"}
    if "RIKS" in card.options:
        run["analysis"] = "arc-length"
        notes.remarks.append(f"{card}, RIKS: where the path ends; max_load_factor and steps of [run] say it")
    elif round(period / dt) > 1:
        run["load_steps"] = round(period / dt)
    if "STABILIZE" in card.options:
        notes.left_out.append(f"{card}, STABILIZE: the damping that it adds")
    return _Step(run, period, True, True)


def _dynamic(card: Card, notes: Notes) -> _Step:
    line = card.line(0)
    explicit = "EXPLICIT" in card.options
    run: dict[str, Any] = {"method": "CentralDifference"} if explicit else {}
    if "ALPHA" in card.options:
        run.update(method="HHT", alpha=card.value("ALPHA"))
    period = line.number(1)
    if line.text(0):
        run["dt"] = line.number(0)
    else:
        notes.remarks.append(f"{card} gives no time step: [run] lacks dt")
    run["t_end"] = period
    quasi = "".join(card.choice("APPLICATION", "").split()) == "QUASI-STATIC"
    return _Step(run, period, False, quasi)


def _modes(card: Card, notes: Notes) -> _Step:
    run: dict[str, Any] = {"analysis": "modes"}
    if card.lines and card.lines[0].text(0):
        run["count"] = card.lines[0].whole(0)
    if card.lines and any(card.lines[0].fields[1:]):
        notes.left_out.append(f"{card}: limits of frequency and shifts; the lowest modes are found")
    return _Step(run, 1.0, False, False)


def _buckling(card: Card, notes: Notes) -> _Step:
    return _Step({"analysis": "buckling", "count": card.line(0).whole(0)}, 1.0, True, False)
