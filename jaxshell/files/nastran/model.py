"""A Nastran file as a draft of a scene: what case control and bulk data become, and which cards have no counterpart."""

from pathlib import Path
from typing import Any

from jaxshell.files.draft import Draft, Notes
from jaxshell.files.nastran.control import Deck, deck_of_file
from jaxshell.files.nastran.geometry import SHELLS, Geometry
from jaxshell.files.nastran.loads import BEYOND, STATIC, Loads
from jaxshell.files.nastran.masses import MASSES, masses_of
from jaxshell.files.nastran.sections import PROPERTIES, Sections
from jaxshell.model.mesh_files import coordinates
from jaxshell.model.mesh_files.bulk_data import Card, read_file

_SOLUTIONS = {
    **dict.fromkeys(("1", "101", "SESTATIC", "106", "NLSTATIC"), "static"),
    **dict.fromkeys(("3", "103", "SEMODES"), "modes"),
    **dict.fromkeys(("5", "105", "SEBUCKL"), "buckling"),
    **dict.fromkeys(("109", "SEDTRAN", "112", "SEMTRAN", "129", "NLTRAN"), "time"),
}
_READ = (
    *coordinates.CARDS, *SHELLS, *PROPERTIES, "MAT1", "MAT8", "MAT2", "MAT9", "MAT10", "SPC", "SPC1", "SPCADD", "LOAD",
    "DLOAD", *STATIC, *BEYOND, "TLOAD1", "LSEQ", "DAREA", "TABLED1", "TSTEP", "TSTEPNL", "EIGRL", "EIGR", "EIGB",
    "NLPARM", "PARAM", *MASSES,
)  # fmt: skip
"""Cards that are looked at; loads that are not chosen have no part in the answer."""
_HARMLESS = ("PLOTEL", "SET", "ASET", "ASET1", "QSET", "QSET1", "SUPORT", "SUPORT1", "MDLPRM", "NASTRAN", "EIGC")


def read_nastran(path: Path, second_order: str) -> Draft:
    """The draft of a file. Raises FileNotFoundError, and ValueError with file and line for what is wrong."""
    notes = Notes()
    file = read_file(path)
    deck = deck_of_file(file)
    analysis = _analysis(deck, notes)
    statics = analysis in ("static", "buckling")
    geometry = Geometry(path, file, notes, second_order)
    run, end = _run(deck, analysis, notes)
    sections = Sections(deck, geometry, notes, _mass(deck), statics).tables()
    loads = Loads(deck, geometry, notes, end)
    case = deck.first
    loads.supports(deck.chosen(case, "SPC"))
    if statics and "LOAD" in case:
        loads.static(deck.chosen(case, "LOAD"))
    elif analysis == "time" and "DLOAD" in case:
        loads.transient(deck.chosen(case, "DLOAD"))
    for key in ("TEMPERATURE", "TEMP", "MPC", "DEFORM"):
        if key in case:
            notes.missing.append(f"{key} = {case[key]} of case control")
    _list_others(deck, notes)
    masses = masses_of(deck, geometry, notes, _mass(deck))
    tables = {"name": Path(path).stem, **sections, **loads.tables(), **masses, "run": run}
    return Draft(Path(path), geometry.mesh, tables, notes)


def _analysis(deck: Deck, notes: Notes) -> str:
    if deck.solution and deck.solution not in _SOLUTIONS:
        raise ValueError(
            f"SOL {deck.solution} has no counterpart; 101 and 106 (statics), 103 (modes), 105 (buckling), 109, 112 and "
            "129 (transient) have."
        )
    analysis = _SOLUTIONS.get(deck.solution, "static")
    if not deck.solution:
        notes.remarks.append("the file has no SOL: statics is taken")
    if deck.solution in ("101", "1", "109", "112", "SESTATIC", "SEDTRAN", "SEMTRAN"):
        notes.remarks.append(f"SOL {deck.solution} is linear, and jaxshell turns and moves by finite amounts")
    if len(deck.subcases) == 1 and "LOAD" not in deck.first and "LOAD" in {c.name for c in deck.cards}:
        notes.remarks.append("case control chooses no LOAD")
    used = 3 if analysis == "buckling" else 2
    for number in range(used, len(deck.subcases)):
        notes.left_out.append(f"subcase {number}: only the first one is carried over")
    return analysis


def _run(deck: Deck, analysis: str, notes: Notes) -> tuple[dict[str, Any], float]:
    """[run], and the time at which it ends (1 of what is not run in time)."""
    if analysis == "time":
        card = _chosen(deck, "TSTEP", "TSTEPNL")
        if card is None:
            raise ValueError("Case control chooses no TSTEP or TSTEPNL, which a transient solution needs.")
        count, dt, every = card.whole(2), card.number(3), card.whole(4, 1)
        if len([text for text in card.fields[8:] if text]) and card.name == "TSTEP":
            notes.left_out.append(f"{card}: time steps after the first {count}")
        return {"dt": dt, "t_end": count * dt, "save_every": every}, count * dt
    run: dict[str, Any] = {"analysis": analysis}
    if analysis == "static":
        card = _chosen(deck, "NLPARM")
        if card is not None:
            run["load_steps"] = card.whole(2, 10)
        return run, 1.0
    number = deck.chosen(deck.subcases[-1], "METHOD") or deck.chosen(deck.first, "METHOD")
    for card in deck.named("EIGRL", "EIGR", "EIGB"):
        if number and card.whole(1) == number:
            at = {"EIGRL": 4, "EIGR": 6, "EIGB": 6}[card.name]
            if card.text(at):
                run["count"] = card.whole(at)
            if card.text(2 if card.name == "EIGRL" else 3):
                notes.left_out.append(f"{card}: limits of frequency; the lowest are found")
    return run, 1.0


def _chosen(deck: Deck, *names: str) -> Card | None:
    """The card of the names that case control chooses by any of them."""
    for key in names:
        number = deck.chosen(deck.first, key)
        found = [card for card in deck.named(*names) if number and card.whole(1) == number]
        if found:
            return found[0]
    return None


def _mass(deck: Deck) -> float:
    """PARAM,WTMASS: what densities are multiplied by."""
    for card in deck.named("PARAM"):
        if card.text(1).upper() == "WTMASS":
            return card.number(2)
    return 1.0


def _list_others(deck: Deck, notes: Notes) -> None:
    """A line for each kind of card that is not looked at."""
    number: dict[str, list[Card]] = {}
    for card in deck.cards:
        if card.name not in _READ:
            number.setdefault(card.name, []).append(card)
    for name, cards in number.items():
        line = f"{len(cards)} {name} (the first: {cards[0].where})"
        (notes.left_out if name in _HARMLESS else notes.missing).append(line)
    names = [card.text(1).upper() for card in deck.named("PARAM") if card.text(1).upper() != "WTMASS"]
    if names:
        notes.left_out.append(f"PARAM {', '.join(dict.fromkeys(names))}")
