"""What somebody may have meant: the known name that is nearest to an unknown one, for errors."""

from collections.abc import Iterable


def meant(name, known: Iterable[str]) -> str:
    """ " Did you mean 'thickness'?", or nothing where no known name is near."""
    import difflib

    if not isinstance(name, str):
        return ""
    by_lower = {other.lower(): other for other in known}
    found = difflib.get_close_matches(name.lower(), by_lower, 1, 0.6)
    return f" Did you mean {by_lower[found[0]]!r}?" if found else ""


def check_known(where: str, keys: Iterable[str], known: Iterable[str]) -> None:
    """Raise ValueError for a key that is not known, naming the nearest that is, and all."""
    known = list(known)
    for key in keys:
        if key not in known:
            raise ValueError(f"{where} has the unknown key {key!r}.{meant(key, known)} Known keys: {', '.join(known)}.")
