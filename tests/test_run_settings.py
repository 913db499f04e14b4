"""How a scene is run: every key from the command line, a scene file and a result file, and what is refused."""

import jax
import pytest

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.analyses import simulation  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.files.quoted import file_part  # noqa: E402
from jaxshell.files.run_keys import KEYS, RunSettings  # noqa: E402
from jaxshell.results.hdf5 import read_settings  # noqa: E402

SCENE = """
[mesh]
generator = "rectangle"
length = 1.0
width = 0.5
divisions = [2, 1]
[section]
thickness = 0.05
young_modulus = 1e4
poisson_ratio = 0.3
density = 1.0
[[supports]]
plane = { x = 0.0 }
hold = "clamped"
[[loads]]
kind = "force"
nearest = [1, 0, 0]
force = [0, 0, 0.01]
[watch]
tip = { nearest = [1, 0, 0], component = "uz" }
"""

# Every key with a value that is not the default; methods differ in their parameters.
COMMON = {
    "dt": 0.01,
    "t_end": 0.03,
    "save_every": 2,
    "reactions": True,
    "tangent": "autodiff",
    "linear_solver": "dense",
    "kernels": "llvm",
    "newton_tolerance": 1e-6,
    "newton_max_iterations": 20,
    "newton_max_rotation": 0.2,
    "newton_reuse": False,
    "newton_criterion": "norm",
    "picture_times": (0.0, 0.02),
}
CONTROL = {
    "step_tolerance": 1e-2,
    "step_smallest": 1e-5,
    "step_largest": 0.02,
    "step_output_interval": 0.015,
    "step_horizon": 0.5,
}
PAPER = {
    "method": ("GeneralizedEnergyMomentum",),
    "spectral_radius": 0.9,
    "dissipation": 0.1,
    "inertia": "none",
    "initial_acceleration": "zero",
}
RUNS = {
    "paper": COMMON | PAPER,
    "controlled": COMMON | PAPER | CONTROL,
    "Newmark": COMMON | {"method": ("Newmark",), "beta": 0.3, "gamma": 0.6},
    "HHT": COMMON | {"method": ("HHT",), "alpha": -0.1},
    "adapted": COMMON | PAPER | {"adapt": 0.1, "goal": "tip"},
    "central": {"method": ("CentralDifference",), "safety": 0.5, "rotary": "scaled", "dt": 1e-5, "t_end": 3e-5},
}

SOLVED = {
    key: COMMON[key] for key in COMMON if key.startswith("newton_") or key in ("tangent", "linear_solver", "kernels")
}
ANALYSES = {
    "static": SOLVED | {"load_factors": (0.5, 2.0), "branch": "follow", "save_every": 2},
    "static, adapted": SOLVED | {"analysis": "static", "load_factors": (0.5,), "adapt": 0.2, "goal": "tip"},
    "static in steps": SOLVED | {"analysis": "static", "load_steps": 4, "picture_times": (0.0, 0.5)},
    "arc-length": SOLVED | {"arc_length": 0.1, "max_steps": 7, "max_load_factor": 3.0},
    "modes": {"count": 4, "rigid_modes": False, "preload": 0.5, "inertia": "cubic"},
    "buckling": {"count": 2, "errors": True},
}
ANALYSES = {name: {"analysis": name, **settings} for name, settings in ANALYSES.items()}


def test_every_key_is_tried():
    assert set().union(*RUNS.values(), *ANALYSES.values()) == set(KEYS)


@pytest.mark.parametrize("name", ANALYSES)
def test_other_analyses_are_asked_for_alike(name, monkeypatch, tmp_path):
    """By the command line and a [run] table: the same function with the same arguments."""
    settings = ANALYSES[name]

    def called(function):
        def asked(scene, *positional, **named):
            if function == "solve_static" and settings["analysis"] == "modes":
                return "loaded"
            raise Called(function, getattr(scene.defaults, "picture_times", ()), positional, named)

        return asked

    for home, function in (
        ("statics", "solve_static"),
        ("arc_length", "solve_arc_length"),
        ("modal", "natural_frequencies"),
        ("modal", "linear_buckling"),
    ):
        monkeypatch.setattr(f"jaxshell.analyses.{home}.{function}", called(function))

    def arguments_of(arguments):
        with pytest.raises(Called) as found:
            main([*arguments, "--no-plots", "--quiet", "--output", str(tmp_path)])
        function, times, positional, named = found.value.args
        named = {key: value for key, value in named.items() if key not in ("output", "progress")}
        if "load_factors" in named:
            named["load_factors"] = tuple(map(float, named["load_factors"]))
        return function, times, positional, named

    (tmp_path / "plain.toml").write_text(SCENE)
    (tmp_path / "said.toml").write_text(as_table(settings))
    found = arguments_of(["run", str(tmp_path / "plain.toml"), *as_options(settings)])
    assert found == arguments_of(["run", str(tmp_path / "said.toml")])
    function, times, positional, named = found
    assert times == settings.get("picture_times", ())
    if function == "natural_frequencies":
        assert (positional, named) == ((4, "loaded"), {"rigid_modes": False, "inertia": "cubic"})
    elif function == "linear_buckling":
        assert positional == (2,)
    else:
        assert named["newton"] == js.Newton(1e-6, 20, 0.2, False, "norm") and named["linear_solver"] == js.Dense()
        assert named["tangent"] == "autodiff" and named["save_every"] == settings.get("save_every", 1)
        own = {key: named[key] for key in named if key in KEYS or key == "steps"}
        expected = {
            "static": {"load_factors": (0.5, 2.0), "branch": "follow"},
            "static, adapted": {"load_factors": (0.5,)},
            "static in steps": {"load_factors": (0.25, 0.5, 0.75, 1.0)},
            "arc-length": {"arc_length": 0.1, "steps": 7, "max_load_factor": 3.0},
        }
        others = ("tangent", "linear_solver", "save_every")
        assert {key: value for key, value in own.items() if key not in others} == expected[name]


class Called(Exception):
    """With what `simulate` was called."""


@pytest.fixture
def asked(monkeypatch):
    """main(arguments) → the keyword arguments with which it calls `simulate`, nothing run."""

    def arguments_of(arguments):
        def simulate(scene, method, **options):
            raise Called(scene, method, options)

        with monkeypatch.context() as patch:
            patch.setattr(simulation, "simulate", simulate)
            with pytest.raises(Called) as called:
                main([*arguments, "--no-plots", "--quiet"])
        scene, method, options = called.value.args
        return (
            getattr(scene.defaults, "picture_times", ()),
            method,
            {k: v for k, v in options.items() if k not in ("output", "progress")},
        )

    return arguments_of


def as_options(settings):
    found = []
    for key, value in settings.items():
        flag = "--" + key.replace("_", "-")
        if isinstance(value, bool):
            found.append(flag if value else flag.replace("--", "--no-", 1))
        else:
            # argparse takes -0.1 for a flag unless it is joined to its own.
            words = [str(item) for item in value] if isinstance(value, tuple) else [str(value)]
            found += [flag, *words] if len(words) > 1 or isinstance(value, tuple) else [f"{flag}={words[0]}"]
    return found


def as_table(settings):
    def text(value):
        if isinstance(value, tuple):
            return "[" + ", ".join(text(item) for item in value) + "]"
        return (
            str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else repr(value)
        )

    return SCENE + "[run]\n" + "\n".join(f"{key} = {text(value)}" for key, value in settings.items()) + "\n"


@pytest.mark.parametrize("name", RUNS)
def test_all_three_ask_for_the_same_run(name, asked, tmp_path):
    """The command line, a [run] table, and the result file of a run: the same method and arguments of `simulate`."""
    settings = RUNS[name]
    (tmp_path / "plain.toml").write_text(SCENE)
    (tmp_path / "said.toml").write_text(as_table(settings))
    times, method, options = asked(["run", str(tmp_path / "plain.toml"), *as_options(settings)])
    assert times == settings.get("picture_times", ())
    assert asked(["run", str(tmp_path / "said.toml")]) == (times, method, options)
    for key in (
        "spectral_radius",
        "dissipation",
        "inertia",
        "initial_acceleration",
        "beta",
        "gamma",
        "alpha",
        "safety",
        "rotary",
    ):
        assert getattr(method, key, None) == settings.get(key)
    assert type(method).__name__ == settings["method"][0]
    if "step_tolerance" in settings:
        control = options["dt"]
        assert isinstance(control, js.StepControl) and control.initial == settings["dt"]
        assert all(getattr(control, key.removeprefix("step_")) == value for key, value in CONTROL.items())
    else:
        assert options["dt"] == settings["dt"]
    if name != "central":
        newton = options["newton"]
        keys = [key for key in settings if key.startswith("newton_")]
        assert all(getattr(newton, key.removeprefix("newton_")) == settings[key] for key in keys) and len(keys) == 5
        assert (options["t_end"], options["save_every"], options["tangent"]) == (0.03, 2, "autodiff")
        assert options["reactions"] is True and options["linear_solver"] == js.Dense()


@pytest.mark.parametrize("name", [pytest.param("paper", marks=pytest.mark.slow), "controlled"])
def test_result_file_says_it_again(name, asked, tmp_path):
    """A file that a run wrote asks for the same run: what its settings say, key by key."""
    settings = RUNS[name]
    (tmp_path / "said.toml").write_text(as_table(settings))
    assert main(["run", str(tmp_path / "said.toml"), "--output", str(tmp_path), "--no-plots", "--quiet"]) == 0
    found = RunSettings.from_result_file(read_settings(tmp_path / "said.h5")).said()
    # A scene's picture times are part of the scene.
    assert found == {key: value for key, value in settings.items() if key != "picture_times"}
    assert asked(["run", str(tmp_path / "said.h5")]) == asked(["run", str(tmp_path / "said.toml")])


def test_command_line_comes_before_the_file(asked, tmp_path):
    (tmp_path / "said.toml").write_text(as_table(RUNS["controlled"]))
    run = ["run", str(tmp_path / "said.toml")]
    _, method, options = asked(
        [*run, "--dissipation", "0.2", "--no-reactions", "--newton-reuse", "--step-largest", "0.01"]
    )
    assert (method.dissipation, method.spectral_radius) == (0.2, 0.9)
    assert options["reactions"] is False and options["newton"].reuse and options["newton"].criterion == "norm"
    assert (options["dt"].largest, options["dt"].smallest) == (0.01, 1e-5)
    # Another method comes without the parameters of the file's.
    _, method, _ = asked([*run, "--method", "Newmark"])
    assert method == js.Newmark()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('dt = "0.01"', "[run] dt must be a number, but it is '0.01'"),
        ("dt = true", "[run] dt must be a number, but it is True"),
        ("dt = nan", "[run] dt must be a number, but it is nan"),
        ("dt = [0.01]", "[run] dt must be a number"),
        ("save_every = 1.5", "[run] save_every must be a whole number of at least 1, but it is 1.5"),
        ("save_every = 0", "[run] save_every must be a whole number of at least 1, but it is 0"),
        ("save_every = true", "[run] save_every must be a whole number"),
        ('newton_reuse = "a"', "[run] newton_reuse must be true or false, but it is 'a'"),
        ("newton_reuse = 1", "[run] newton_reuse must be true or false, but it is 1"),
        ("method = 3", "[run] method must be a name or a list of names, but it is 3"),
        ('method = [["EMC"]]', "[run] method must be a name or a list of names"),
        ("method = []", "[run] method must be a name or a list of names"),
        (
            'inertia = "much"',
            "[run] inertia must be one of seven_point, traditional, none, linear, cubic, but it is 'much'",
        ),
        ("goal = 3", "[run] goal must be a label, which is text, but it is 3"),
        ('goal = ""', "[run] goal must be a label, which is text, but it is ''"),
        ('adapt = "fine"', "[run] adapt must be a number, but it is 'fine'"),
        (
            'analysis = "modes"\nadapt = 0.1',
            '[run] adapt is for analysis = "time" or "static", but the analysis is "modes"',
        ),
        ("picture_times = 0.1", "[run] picture_times must be a list of numbers, but it is 0.1"),
        ("picture_times = [true]", "[run] picture_times must be a list of numbers"),
        ("stepsize = 0.1", "[run] has the unknown key 'stepsize'"),
    ],
)
def test_what_a_key_cannot_be(line, message, tmp_path, capsys):
    (tmp_path / "wrong.toml").write_text(f"{SCENE}[run]\n{line}\n")
    assert main(["run", str(tmp_path / "wrong.toml"), "--quiet"]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("dt = 1e-12\nt_end = 1.0", "t_end = 1 with dt = 1e-12 asks for 1e+12 steps, and at most 1e+08 are taken"),
        ("dt = 0.1\nt_end = 1e308", "t_end must be at most 1e+100 in size, but it is 1e+308"),
        ("dt = 0.1\nt_end = 5e-324", "t_end must be at least 1e-100, but it is 5e-324"),
        ('dt = 0.1\nt_end = 1.0\nmethod = "rk4"', "There is no method 'rk4'"),
    ],
)
def test_runs_beyond_reason(line, message, tmp_path, capsys):
    (tmp_path / "wrong.toml").write_text(f"{SCENE}[run]\n{line}\n")
    assert main(["run", str(tmp_path / "wrong.toml"), "--quiet", "--no-plots", "--output", str(tmp_path)]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "part"),
    [("spherical_cap", "spherical_cap"), ("../../x", "_.._x"), ("/etc/passwd", "_etc_passwd"), (".hidden", "hidden"),
     ("", "scene"), ("..", "scene"), ("a\0b\n", "a_b_"), ("C:\\x", "C__x"), ("ξ = 1", "ξ___1"), ("é" * 300, "é" * 50)],
)  # fmt: skip
def test_any_text_as_a_part_of_a_files_name(text, part, tmp_path):
    assert file_part(text) == part
    assert (tmp_path / part).parent == tmp_path
    (tmp_path / part).write_text("x")


def test_keys_of_step_control_need_it(tmp_path, capsys):
    (tmp_path / "plain.toml").write_text(SCENE)
    arguments = ["run", str(tmp_path / "plain.toml"), "--dt", "0.1", "--t-end", "1", "--step-smallest", "0.01"]
    assert main(arguments) == 2
    assert "step_smallest is of step control, which step_tolerance switches on" in capsys.readouterr().err
