"""The package's public names: imported at first use, the same to type checkers, and nobody's in the way."""

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import jaxshell as js


def fresh(code: str) -> None:
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr


def test_a_type_checker_sees_the_names_where_they_are_found():
    source = ast.parse(Path(js.__file__).read_text(encoding="utf-8"))
    (checked,) = [node for node in source.body if isinstance(node, ast.If) and isinstance(node.test, ast.Name)]
    seen = {
        alias.name: (node.module.removeprefix("jaxshell").lstrip(".") or alias.name)
        for node in checked.body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
    assert seen == {name: home for home, names in js._HOMES.items() for name in names}
    assert sorted(seen) == sorted(js.__all__) and set(js.__all__) <= set(dir(js))
    for name in js.__all__:
        assert getattr(js, name) is not None


def test_no_public_name_is_a_modules():
    """Importing jaxshell.x sets the package's x: a function of that name would be gone."""
    modules = {module.name for module in pkgutil.iter_modules(js.__path__)}
    assert modules & set(js.__all__) == {"gradients", "methods", "plotting", "scenes"}


def test_packages_that_the_docs_teach_and_the_version():
    fresh(
        "import jaxshell as js\n"
        "assert js.methods.Newmark is js.Newmark and js.gradients.Stored is js.Stored\n"
        "assert callable(js.plotting.plot) and 'cap' in js.scenes.PAPER\n"
        "from importlib.metadata import version\n"
        "assert js.__version__ == version('jaxshell')\n"
    )


def test_unknown_name():
    with pytest.raises(AttributeError, match="'jaxshell' has no attribute 'simulat'"):
        _ = js.simulat
    with pytest.raises(ImportError, match="simulat"):
        exec("from jaxshell import simulat")


def test_help_does_not_wait_for_jax():
    fresh(
        "import sys\n"
        "from jaxshell.command.cli import main\n"
        "for argument in ('--help', '--version'):\n"
        "    try:\n"
        "        main([argument])\n"
        "    except SystemExit as end:\n"
        "        assert not end.code\n"
        "assert not {'jax', 'numpy', 'matplotlib', 'h5py'} & set(sys.modules)\n"
    )


def test_first_use_inside_a_trace_keeps_no_tracer():
    """Modules that compute with arrays when they are imported would keep those of the trace."""
    fresh(
        "import jax\n"
        "jax.config.update('jax_enable_x64', True)\n"
        "import jaxshell as js\n"
        "def thin(thickness):\n"
        "    for name in js.__all__:\n"
        "        getattr(js, name)\n"
        "    return js.Section(thickness, 1.0, 0.3, 1.0).thickness\n"
        "with jax.check_tracer_leaks():\n"
        "    assert jax.jit(thin)(0.5) == 0.5\n"
    )
