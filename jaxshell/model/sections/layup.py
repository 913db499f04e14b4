"""Layups written as text, in the usual shorthand of laminates."""

import re

from jaxshell.numerics.checks import check_text, shown

MOST_PLIES = 1000
"""A layup with more is taken for a slip of the pen."""
_DEEPEST = 20
"""Brackets within brackets."""


def read_layup(text: str) -> tuple[list[float], bool]:
    """Ply angles [degrees] from the bottom up, and whether they are the lower half of a symmetric laminate.

    "[45/-45/0/90]s": the plies between brackets, then the same in reverse ("s", symmetric); "[0/90]2s": the bracket
    twice, then mirrored; "[±45/0_2]", "[+-45/02]": a pair, and two plies of 0° (a count follows an underscore or, after
    a single 0 or in subscript digits, the angle); a starred last ply, "[0/90*]s", lies in the middle of the symmetric
    laminate, once. Commas or slashes part the plies; brackets may be nested, "[0/[45/-45]2]s".

    Raises ValueError, with the place, for a text that is none of this.
    """
    check_text("A layup", text)
    plain = text.translate(_SUBSCRIPTS).replace("−", "-").replace("°", "").replace("+-", "±").replace("-+", "∓")
    parser = _Parser(text, plain)
    angles, symmetric = parser.bracket(outermost=True)
    parser.end()
    return angles, symmetric


_SUBSCRIPTS = {ord(digit): f"_{k}" for k, digit in enumerate("₀₁₂₃₄₅₆₇₈₉")}
_TOKEN = re.compile(r"\s*(?:(?P<angle>[±∓]?[+-]?\d+(?:\.\d*)?|[±∓]?[+-]?\.\d+)|(?P<mark>[\[\]/,_*sST]))")


class _Parser:
    """A layup's text, read from left to right."""

    def __init__(self, text: str, plain: str):
        self.text, self.tokens, self.depth, at = text, [], 0, 0
        plain = plain.replace("(", "[").replace(")", "]")
        while plain[at:].strip():
            found = _TOKEN.match(plain, at)
            if not found:
                self.fail(f"{plain[at:].strip()[:12]!r} is no angle")
            self.tokens.append(found.group("angle") or found.group("mark"))
            at = found.end()
        self.at = 0

    def fail(self, reason: str):
        raise ValueError(
            f"The layup {shown(self.text)} cannot be read: {reason}. Write it as [45/-45/0/90]s, [0_2/±45]2s or "
            "[0/90*]s."
        )

    def peek(self) -> str:
        return self.tokens[self.at] if self.at < len(self.tokens) else ""

    def take(self, wanted: str = "") -> str:
        token = self.peek()
        if wanted and token != wanted:
            self.fail(f"{wanted!r} is missing before {token!r}" if token else f"{wanted!r} is missing at the end")
        self.at += 1
        return token

    def end(self):
        if self.peek():
            self.fail(f"{self.peek()!r} follows after its end")

    def count(self) -> int:
        """A number of repetitions, 1 where none stands here."""
        if self.peek() == "_":
            self.take()
        elif not self.peek().isdigit():
            return 1
        token = self.take()
        if not token.isdigit() or not 1 <= int(token) <= MOST_PLIES:
            self.fail(f"{token!r} is no count of plies")
        return int(token)

    def bracket(self, outermost: bool = False) -> tuple[list[float], bool]:
        """The angles of a bracket, and whether they are a lower half, which only those of the outermost may be."""
        plies, middle = self.inside()
        repeats = self.count()
        if repeats * len(plies) > MOST_PLIES:
            self.fail(f"it has more than {MOST_PLIES} plies")
        plies = plies * repeats
        if self.peek() not in ("s", "S"):
            if middle:
                self.fail("a ply in the middle needs a symmetric layup, with s behind the bracket")
            if self.peek() == "T":  # total: these are all
                self.take()
            return plies, False
        self.take()
        if middle:
            return plies + plies[-2::-1] if len(plies) > 1 else plies, False
        return (plies, True) if outermost else (plies + plies[::-1], False)

    def inside(self) -> tuple[list[float], bool]:
        """The angles between a bracket's two marks, and whether the last ply lies in the middle."""
        self.take("[")
        self.depth += 1
        if self.depth > _DEEPEST:
            self.fail(f"its brackets are nested more than {_DEEPEST} deep")
        plies, middle = [], False
        while True:
            plies += self.bracket()[0] if self.peek() == "[" else self.ply()
            if self.peek() == "*":
                self.take()
                middle = True
            if len(plies) > MOST_PLIES:
                self.fail(f"it has more than {MOST_PLIES} plies")
            if self.peek() not in ("/", ","):
                break
            if middle:
                self.fail("only the last ply can lie in the middle")
            self.take()
        self.take("]")
        self.depth -= 1
        return plies, middle

    def ply(self) -> list[float]:
        token = self.take()
        sign = token[:1] if token[:1] in "±∓" else ""
        number = token[len(sign) :]
        repeats = 0
        if re.fullmatch(r"0[1-9]\d?", number):  # 02 is 0₂
            repeats, number = int(number[1:]), "0"
        try:
            angle = float(number)
        except ValueError:
            self.fail(f"{token!r} stands where an angle belongs" if token else "it ends where an angle belongs")
        if abs(angle) > 360:
            self.fail(f"the angle {token} is above 360 degrees")
        if not repeats:
            repeats = self.count() if self.peek() == "_" else 1
        pair = {"±": [angle, -angle], "∓": [-angle, angle]}.get(sign, [angle])
        return pair * repeats
