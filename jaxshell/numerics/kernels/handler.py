"""A function that XLA calls with arrays of all elements: loads, the function of one element, stores, in a loop."""

from collections.abc import Sequence

import numpy as np
from jax.extend.core import ClosedJaxpr

from jaxshell.numerics.kernels.code import Code, Vector
from jaxshell.numerics.kernels.operations import as_entries, evaluate

# Fields of XLA's call frame (xla/ffi/api/c_api.h of jaxlib), in bytes from its start.
_EXTENSIONS, _ARGUMENTS, _RESULTS = 8, 72, 112  # of the frame
_DATA, _DIMENSIONS = 24, 40  # of an array
_KIND, _METADATA, _METADATA_KIND = 8, 24, 1  # of an extension of the frame
_MAJOR, _MINOR = 24, 28  # of the metadata that are asked for


def _blocks(size: int, width: int) -> list[int]:
    """Starts of blocks of `width` that cover `size` numbers, the last of them moved back to end with them."""
    return [min(first, size - width) for first in range(0, size, width)]


def _load(code: Code, place: str, offset: int) -> Vector:
    at = code.name()
    code.lines.append(f"  {at} = getelementptr double, ptr {place}, i64 {offset}")
    return code.made(f"load {code.vector}, ptr {at}, align 8")


def _store(code: Code, place: str, offset: int, value) -> None:
    at = code.name()
    code.lines.append(f"  {at} = getelementptr double, ptr {place}, i64 {offset}")
    code.lines.append(f"  store {code.vector} {code.text(value)}, ptr {at}, align 8")


def _place(code: Code, pointer: str, size: int) -> str:
    """Where the numbers of element %e begin, in an array of `size` numbers for each."""
    offset, place = code.name() + "o", code.name()
    code.lines.append(f"  {offset} = mul i64 %e, {size}")
    code.lines.append(f"  {place} = getelementptr double, ptr {pointer}, i64 {offset}")
    return place


def _loaded(code: Code, pointer: str, size: int) -> list[Vector]:
    """The `size` numbers of each of the elements %e, %e + 1, …"""
    if size == 0:
        return []
    width, place = code.width, _place(code, pointer, size)
    if size < width:
        flat = [_load(code, place, j * width) for j in range(size)]
        return [code.picked(flat, [lane * size + c for lane in range(width)]) for c in range(size)]
    found: list[Vector] = []
    for first in _blocks(size, width):
        rows = [_load(code, place, i * size + first) for i in range(width)]
        found.extend(code.transposed(rows)[len(found) - first :])
    return found


def _shared(code: Code, pointer: str, size: int) -> list[Vector]:
    """Numbers that all elements share, read before the loop."""
    found = []
    for c in range(size):
        own = f"{pointer}s{c}"
        code.before += [
            f"  {own}p = getelementptr double, ptr {pointer}, i64 {c}",
            f"  {own}l = load double, ptr {own}p, align 8",
            f"  {own}i = insertelement {code.vector} undef, double {own}l, i32 0",
            f"  {own} = shufflevector {code.vector} {own}i, {code.vector} undef, <{code.width} x i32> zeroinitializer",
        ]
        found.append(Vector(code, own))
    return found


def _formed(code: Code, value) -> Vector:
    """A constant as a vector with a name, for shuffles."""
    if isinstance(value, Vector):
        return value
    return code.made(f"fadd {code.vector} {code.text(value)}, splat (double 0x8000000000000000)")


def _stored(code: Code, pointer: str, values: list) -> None:
    size, width = len(values), code.width
    if size == 0:
        return
    place = _place(code, pointer, size)
    vectors = [_formed(code, value) for value in values]
    if size < width:
        for j in range(size):
            at = [divmod(j * width + lane, size) for lane in range(width)]
            _store(code, place, j * width, code.picked(vectors, [c * width + element for element, c in at]))
        return
    for first in _blocks(size, width):
        for i, row in enumerate(code.transposed(vectors[first : first + width])):
            _store(code, place, i * size + first, row)


def handler_text(closed: ClosedJaxpr, mapped: Sequence[bool], width: int, version: tuple[int, int], name: str) -> str:
    """The LLVM text of a handler for XLA that applies a function of one element to all of them.

    `mapped` says which arguments have an entry for each element; the others all elements share, whole numbers among
    them as floats. There are to be at least `width` elements. `version` is that of XLA's calls. Raises Unsupported for
    operations that have no straight-line form.
    """
    code = Code(width)
    arguments = []
    for k, (aval, own) in enumerate(zip(closed.in_avals, mapped, strict=True)):
        entries = np.empty(aval.size, dtype=object)
        entries[:] = (_loaded if own else _shared)(code, f"%a{k}", aval.size)
        arguments.append(entries.reshape(aval.shape))
    results = evaluate(code, closed.jaxpr, [as_entries(c) for c in closed.consts], arguments)
    for k, array in enumerate(results):
        _stored(code, f"%r{k}", list(array.reshape(-1)))
    pointers = [line for k in range(len(mapped)) for line in _pointer(f"a{k}", "%arguments", k)]
    pointers += [line for k in range(len(results)) for line in _pointer(f"r{k}", "%results", k)]
    counted = f"%a{list(mapped).index(True)}b"
    return "\n".join(
        [*sorted(code.declared), *_asked_for_version(name, version), *pointers, *_loop(code, counted), "}"]
    )


def _asked_for_version(name: str, version: tuple[int, int]) -> list[str]:
    """The handler's first lines: to be registered, XLA calls it once without arrays and asks for its version."""
    return [
        f"define ptr @{name}(ptr %frame) {{",
        *_field("extension", _EXTENSIONS, "ptr", "%frame"),
        "  %plain = icmp eq ptr %extension, null",
        "  br i1 %plain, label %work, label %asked",
        "asked:",
        *_field("kind", _KIND, "i32", "%extension"),
        f"  %known = icmp eq i32 %kind, {_METADATA_KIND}",
        "  br i1 %known, label %tell, label %work",
        "tell:",
        *_field("metadata", _METADATA, "ptr", "%extension"),
        f"  %major = getelementptr i8, ptr %metadata, i64 {_MAJOR}",
        f"  store i32 {version[0]}, ptr %major",
        f"  %minor = getelementptr i8, ptr %metadata, i64 {_MINOR}",
        f"  store i32 {version[1]}, ptr %minor",
        "  ret ptr null",
        "work:",
        *_field("arguments", _ARGUMENTS, "ptr", "%frame"),
        *_field("results", _RESULTS, "ptr", "%frame"),
    ]


def _pointer(name: str, among: str, k: int) -> list[str]:
    """The numbers of array k."""
    return [
        f"  %{name}q = getelementptr ptr, ptr {among}, i64 {k}",
        f"  %{name}b = load ptr, ptr %{name}q",
        *_field(name, _DATA, "ptr", f"%{name}b"),
    ]


def _field(name: str, offset: int, kind: str, of: str) -> list[str]:
    return [f"  %{name}f = getelementptr i8, ptr {of}, i64 {offset}", f"  %{name} = load {kind}, ptr %{name}f"]


def _loop(code: Code, counted: str) -> list[str]:
    """Over the elements, as many as the array `counted` has. The last block is moved back to end with them: some
    elements are computed twice, and none past the end."""
    return [
        *_field("sizes", _DIMENSIONS, "ptr", counted),
        "  %n = load i64, ptr %sizes",
        f"  %last = sub i64 %n, {code.width}",
        *code.before,
        "  br label %loop",
        "loop:",
        "  %next = phi i64 [ 0, %work ], [ %after, %loop ]",
        "  %full = icmp slt i64 %next, %last",
        "  %e = select i1 %full, i64 %next, i64 %last",
        *code.lines,
        f"  %after = add i64 %next, {code.width}",
        "  %more = icmp slt i64 %after, %n",
        "  br i1 %more, label %loop, label %end",
        "end:",
        "  ret ptr null",
    ]
