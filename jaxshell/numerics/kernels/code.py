"""Straight-line vector code, as the text of LLVM: one vector for each number of a function of one element.

What is computed twice is written once, and what is always zero not at all. A zero times a number is zero here, also
where the number is not finite: of numbers that run over, others of the same element tell.
"""

import math
import struct
from collections.abc import Sequence


class Unsupported(Exception):
    """What has no straight-line form: the function then stays with XLA."""


class Vector:
    """One number of the function, of `width` elements: a name in the text. `is_truth` where it is true or false."""

    __slots__ = ("code", "is_truth", "name")

    def __init__(self, code: "Code", name: str, is_truth: bool = False):
        self.code, self.name, self.is_truth = code, name, is_truth

    def __add__(self, other):
        return self if _is(other, 0.0) else self.code.binary("fadd", self, other)

    def __sub__(self, other):
        return self if _is(other, 0.0) else self.code.binary("fsub", self, other)

    def __rsub__(self, other):
        return -self if _is(other, 0.0) else self.code.binary("fsub", other, self)

    def __mul__(self, other):
        if _is(other, 0.0):
            return 0.0
        if _is(other, 1.0):
            return self
        return -self if _is(other, -1.0) else self.code.binary("fmul", self, other)

    def __truediv__(self, other):
        if not isinstance(other, Vector) and math.frexp(other)[0] == 0.5:  # exact, and a division takes far longer
            return self * (1.0 / other)
        return self.code.binary("fdiv", self, other)

    def __rtruediv__(self, other):
        return 0.0 if _is(other, 0.0) else self.code.binary("fdiv", other, self)

    def __neg__(self):
        return self.code.made(f"fneg {self.code.vector} {self.name}")

    __radd__, __rmul__ = __add__, __mul__


def _is(value, constant: float) -> bool:
    return not isinstance(value, Vector) and value == constant


class Code:
    """The lines of a loop over elements, those before it, and what they have made."""

    def __init__(self, width: int):
        self.width, self.vector, self.truths = width, f"<{width} x double>", f"<{width} x i1>"
        self.before: list[str] = []
        self.lines: list[str] = []
        self.declared: set[str] = set()
        self._made: dict[str, Vector] = {}

    def name(self) -> str:
        """A new one for the next line."""
        return f"%v{len(self.lines) + len(self.before)}"

    def made(self, expression: str, is_truth: bool = False) -> Vector:
        """The vector that an expression gives; the same one where it was asked before."""
        found = self._made.get(expression)
        if found is None:
            found = self._made[expression] = Vector(self, self.name(), is_truth)
            self.lines.append(f"  {found.name} = {expression}")
        return found

    def text(self, value) -> str:
        """A vector's name, or a constant."""
        if isinstance(value, Vector):
            return value.name
        if isinstance(value, bool):
            return f"splat (i1 {'true' if value else 'false'})"
        return f"splat (double 0x{struct.unpack('>Q', struct.pack('>d', float(value)))[0]:016X})"

    def binary(self, operation: str, a, b) -> Vector:
        """Of two numbers; a product and a sum may become one instruction, which rounds once."""
        return self.made(f"{operation} contract {self.vector} {self.text(a)}, {self.text(b)}")

    def called(self, function: str, *values) -> Vector:
        """By a function of vectors."""
        kind = self.vector
        self.declared.add(f"declare {kind} @{function}({', '.join([kind] * len(values))})")
        arguments = ", ".join(f"{kind} {self.text(v)}" for v in values)
        return self.made(f"call {kind} @{function}({arguments})")

    def shuffled(self, a: Vector, b: Vector, lanes: Sequence[int]) -> Vector:
        """Lanes of a, and of b from `width` on."""
        mask = ", ".join(f"i32 {lane}" for lane in lanes)
        v = self.vector
        return self.made(f"shufflevector {v} {a.name}, {v} {b.name}, <{len(lanes)} x i32> <{mask}>")

    def transposed(self, rows: list[Vector]) -> list[Vector]:
        """The columns of a square of vectors."""
        rows, distance = list(rows), 1
        while distance < self.width:
            lanes = range(self.width)
            low = [lane if not lane & distance else self.width + lane - distance for lane in lanes]
            high = [lane + distance if not lane & distance else self.width + lane for lane in lanes]
            for i in range(self.width):
                if not i & distance:
                    j = i + distance
                    rows[i], rows[j] = self.shuffled(rows[i], rows[j], low), self.shuffled(rows[i], rows[j], high)
            distance *= 2
        return rows

    def picked(self, sources: list[Vector], places: list[int]) -> Vector:
        """Lanes from several vectors, laid end to end: places[k] stands in lane k."""
        width, found = self.width, None
        for s in range(len(sources)):
            inside = [s * width <= p < (s + 1) * width for p in places]
            if not any(inside):
                continue
            if found is None:
                first = [p - s * width if own else 0 for p, own in zip(places, inside, strict=True)]
                found = self.shuffled(sources[s], sources[s], first)
            else:
                more = enumerate(zip(places, inside, strict=True))
                lanes = [width + p - s * width if own else k for k, (p, own) in more]
                found = self.shuffled(found, sources[s], lanes)
        assert found is not None
        return found
