"""Which linear solver there is: missing packages, the default, and what importing and preparing leave alone."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from systems import SOLVERS, available

from jaxshell.solvers.linear_solver import KLU, Dense, Pardiso, default_solver


@pytest.fixture(params=SOLVERS, ids=lambda kind: kind.__name__)
def solver(request):
    return available(request.param)


@pytest.mark.parametrize(
    "solver, module, package", [(Pardiso, "pardiso_mkl_jax", "pardiso-mkl-jax"), (KLU, "klujax", "klujax")]
)
def test_missing_package(monkeypatch, solver, module, package):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=f"pip install {package}"):
        solver()


def test_default_solver(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "arm64")
    assert not isinstance(default_solver(), Pardiso)
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    for module, missing_from_here in (("pardiso_mkl_jax", Pardiso), ("klujax", KLU)):
        monkeypatch.setitem(sys.modules, module, None)
        assert not isinstance(default_solver(), missing_from_here)
    assert isinstance(default_solver(), Dense)


def in_fresh_process(code):
    root = str(Path(__file__).parents[1])
    environment = {k: v for k, v in os.environ.items() if k not in ("JAX_ENABLE_X64", "MKL_NUM_THREADS")}
    environment["PYTHONPATH"] = root + os.pathsep + environment.get("PYTHONPATH", "")
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_import_changes_nothing():
    in_fresh_process(
        "import os, sys, jax\n"
        "before, environment = jax.config.values, dict(os.environ)\n"
        "import jaxshell.solvers.linear_solver\n"
        "assert jax.config.values == before and dict(os.environ) == environment\n"
        "assert 'pardiso_mkl_jax' not in sys.modules and 'klujax' not in sys.modules\n"
    )


def test_preparing_changes_no_setting_of_jax(solver):
    in_fresh_process(
        "import jax\n"
        f"from jaxshell.solvers.linear_solver import {type(solver).__name__}, SparsityPattern\n"
        "before = jax.config.values\n"
        "with jax.enable_x64(True):\n"
        f"    {type(solver).__name__}().prepare(SparsityPattern(1, [0, 1], [0]))\n"
        "assert jax.config.values == before\n"
    )


def test_float64_off(solver):
    in_fresh_process(
        f"from jaxshell.solvers.linear_solver import {type(solver).__name__}, SparsityPattern\n"
        "try:\n"
        f"    {type(solver).__name__}().prepare(SparsityPattern(1, [0, 1], [0]))\n"
        "except RuntimeError as error:\n"
        "    assert 'jax_enable_x64' in str(error)\n"
        "else:\n"
        "    raise SystemExit('no error')\n"
    )
