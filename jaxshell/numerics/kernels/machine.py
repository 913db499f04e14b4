"""Kernels compiled by LLVM for this machine's processor, and made known to XLA."""

import ctypes
import hashlib
import os
import re
import tempfile
import threading
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
from jax.extend.core import ClosedJaxpr

from jaxshell.numerics.kernels.handler import handler_text

_compiled: dict[str, Any] = {}  # what holds machine code in memory, by the kernel's name
_lock = threading.Lock()


class Machine(NamedTuple):
    """LLVM's binding, the processor and what it has, and functions of vectors in the place of LLVM's own."""

    llvm: Any
    processor: str
    features: str
    width: int
    """Numbers in a vector."""
    functions: dict[str, str]


def require_llvm() -> None:
    """Raise ImportError where kernels cannot be compiled, RuntimeError where XLA could not call them."""
    try:
        this_machine()
    except ImportError as error:
        raise ImportError('Kernels by LLVM need llvmlite: pip install llvmlite, or leave kernels at "xla".') from error
    _version_of_calls()


@cache
def this_machine() -> Machine:
    from llvmlite import binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    has = llvm.get_host_cpu_features()
    width = 8 if has.get("avx512f") else 4 if has.get("avx2") else 2
    # LLVM halves the longest vectors of some processors, which have no other work for them here.
    features = has.flatten() + (",-prefer-256-bit" if width == 8 else "")
    return Machine(llvm, llvm.get_host_cpu_name(), features, width, _functions(llvm, width))


def _functions(llvm, width: int) -> dict[str, str]:
    """glibc's sine and cosine of vectors, where this system has them: LLVM calls those of single numbers in turn."""
    found = {}
    try:
        library = ctypes.CDLL("libmvec.so.1")
        for function in ("sin", "cos"):
            name = f"_ZGV{ {8: 'e', 4: 'd', 2: 'b'}[width] }N{width}v_{function}"
            llvm.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
            found[f"@llvm.{function}.v{width}f64("] = f"@{name}("
    except (OSError, AttributeError):
        return {}
    return found


@cache
def _version_of_calls() -> tuple[int, int]:
    """Of XLA's calls, as jaxlib's header says."""
    header = (Path(jax.ffi.include_dir()) / "xla" / "ffi" / "api" / "c_api.h").read_text(encoding="utf-8")
    found = [re.search(rf"#define XLA_FFI_API_{which} (\d+)", header) for which in ("MAJOR", "MINOR")]
    major, minor = (int(f[1]) if f else -1 for f in found)
    if major != 0:
        raise RuntimeError(
            f"Kernels by LLVM know XLA's calls of version 0, but this jaxlib has version {major}: leave kernels at "
            '"xla".'
        )
    return major, minor


def kernel_of(closed: ClosedJaxpr, mapped: tuple[bool, ...]) -> str:
    """The name under which XLA calls a function of one element for all of them; see `handler_text`.

    The same function has the same name in every process: so XLA's compiled programs can be kept. Raises Unsupported.
    """
    machine = this_machine()
    text = handler_text(closed, mapped, machine.width, _version_of_calls(), "KERNEL")
    for plain, own in machine.functions.items():
        text = text.replace(plain, own)
    made_by = (text, machine.processor, machine.features, machine.llvm.llvm_version_info)
    name = f"jaxshell_{hashlib.sha256(repr(made_by).encode()).hexdigest()[:32]}"
    with _lock:
        if name not in _compiled:
            _compiled[name] = engine = _loaded(machine, name, text.replace("@KERNEL(", f"@{name}("))
            jax.ffi.register_ffi_target(name, _capsule(engine.get_function_address(name)), platform="cpu")
    return name


def _loaded(machine: Machine, name: str, text: str):
    """The machine code in memory: out of the folder where JAX keeps compiled programs, or compiled and kept there."""
    llvm, folder = machine.llvm, jax.config.values["jax_compilation_cache_dir"]
    path = Path(folder) / f"{name}.o" if folder and Path(folder).is_dir() else None
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=machine.processor, features=machine.features, opt=2
    )
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target)
    content = path.read_bytes() if path is not None and path.exists() else None
    if content is None or not _whole(content):
        content = _signed(target.emit_object(llvm.parse_assembly(text)))
        if path is not None:
            _write(path, content)
    engine.add_object_file(llvm.object_file.ObjectFileRef.from_data(content[_SIGNATURE:]))
    engine.finalize_object()
    return engine


_SIGNATURE = 32  # bytes


def _signed(content: bytes) -> bytes:
    return hashlib.sha256(content).digest() + content


def _whole(content: bytes) -> bool:
    return _signed(content[_SIGNATURE:]) == content


def _write(path: Path, content: bytes) -> None:
    """At once, so that no other process reads a part; a folder that cannot be written to is no error."""
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(content)
        os.replace(file.name, path)
    except OSError:
        return


def _capsule(address: int):
    make = ctypes.pythonapi.PyCapsule_New
    make.restype, make.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    return make(address, b"xla._CUSTOM_CALL_TARGET", None)
