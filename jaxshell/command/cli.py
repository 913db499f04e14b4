"""The command `jaxshell`: run a scene, plot result files, chart and advise on speed, list the scenes.

Exit status: 0, or 1 when a run failed (what it finished is kept and drawn), 2 for bad input, 128 and the signal's
number when stopped by one: 130 by the keyboard, 143 by SIGTERM, 129 by SIGHUP. JAX and matplotlib are imported when a
command needs them, and float64 is switched on here.
"""

import argparse
import itertools
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from jaxshell.command.run_settings import (
    arguments_of_simulate,
    chosen_methods,
    first_step,
    one_thread_for_small_meshes,
    open_scene,
    required,
    settled,
    solution_to_go_on_from,
    what_is_left,
    with_picture_times,
)
from jaxshell.files.quoted import file_part
from jaxshell.files.run_keys import add_options
from jaxshell.numerics.signals import LostOutput, exit_status, raising


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status. Errors in the arguments leave through SystemExit(2)."""
    options = _parser().parse_args(arguments)
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(line_buffering=True)  # pyright: ignore[reportAttributeAccessIssue]
    try:
        with raising():
            return options.command(options)
    except KeyboardInterrupt as stopped:
        print("jaxshell: stopped.", file=sys.stderr)
        return exit_status(stopped)
    except BrokenPipeError:  # who read the output has gone
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - until the process ends
        return 141
    except (ValueError, OSError, ImportError) as error:
        print(f"jaxshell: {getattr(error, 'strerror', None) or error}", file=sys.stderr)
        return 1 if isinstance(error, LostOutput) else 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="jaxshell", description="Nonlinear dynamics of thin shells with finite rotations."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and leave")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run a scene; write its results and pictures")
    run.set_defaults(command=_run)
    run.add_argument("scene", metavar="SCENE", help="a scene's name (see `jaxshell scenes`), a .toml or .h5 file")
    run.add_argument(
        "--divisions", type=int, nargs="+", metavar="N", help="divisions of the mesh (library scenes only)"
    )
    add_options(run)
    run.add_argument("--output", type=Path, default=Path("."), metavar="DIR", help="where files go (default: here)")
    run.add_argument(
        "--continue",
        dest="go_on",
        action="store_true",
        help="go on from the end of a result file, to the end it was to have or for --t-end more",
    )
    run.add_argument("--overwrite", action="store_true", help="replace a result file also where its run did not end")
    run.add_argument("--no-plots", action="store_true", help="write the results only")
    run.add_argument("--quiet", action="store_true", help="print errors only")

    plot = commands.add_parser("plot", help="draw result files, several of them together")
    plot.set_defaults(command=_plot)
    plot.add_argument("files", nargs="+", type=Path, metavar="FILE.h5")
    plot.add_argument("--output", type=Path, metavar="DIR", help="where pictures go (default: beside the file)")
    plot.add_argument(
        "--contour",
        action="append",
        default=[],
        metavar="WHAT",
        help='colour the shapes by a stress or section force: "von mises top", "sxx bottom", "Mxx"; may be repeated',
    )

    chart = commands.add_parser("chart", help="draw error against time for every choice, and the best of them")
    chart.set_defaults(command=_chart)
    chart.add_argument("--output", type=Path, default=Path("."), metavar="DIR", help="where files go (default: here)")
    advise = commands.add_parser("advise", help="find the cheapest way to run a scene to a tolerance")
    advise.set_defaults(command=_advise)
    advise.add_argument("--tolerance", type=float, default=1e-2, help="relative error allowed (default: 0.01)")
    advise.add_argument("--output", type=Path, metavar="FILE", help="write the scene file's [run] section here too")
    for command in (chart, advise):
        command.add_argument("scene", metavar="SCENE", help="a scene's name, a .toml or .h5 file")
        command.add_argument("--dt", type=float, help="step to start from (default: the scene's)")
        command.add_argument(
            "--t-end", type=float, help="time that trials cover (default: the reference's, or 100 steps)"
        )
        command.add_argument("--quiet", action="store_true", help="print the outcome only")

    scenes = commands.add_parser("scenes", help="list the scenes that `run` knows by name")
    scenes.set_defaults(command=_scenes)
    return parser


class _Version(argparse.Action):
    def __call__(self, parser, *_):
        from jaxshell.version import version

        print(f"jaxshell {version()}")
        parser.exit()


# --- commands --------------------------------------------------------------------------------------------


def _run(options: argparse.Namespace) -> int:
    one_thread_for_small_meshes(options.scene, options.divisions)
    _prepare_jax()
    from jaxshell.analyses.simulation import simulate
    from jaxshell.command.report import describe_run, describe_scene
    from jaxshell.results.hdf5 import ResultWriter
    from jaxshell.results.solution import RESULTS

    scene, of_file, stem = open_scene(options.scene, options.divisions)
    restart = None
    if options.go_on:
        restart, stem = solution_to_go_on_from(options), f"{Path(options.scene).stem}_continued"
    settings = settled(options, of_file, scene)
    scene = with_picture_times(scene, settings)
    methods, arguments = chosen_methods(settings, scene), arguments_of_simulate(settings)
    t_end = required(settings, "t_end")
    if restart is not None and options.t_end is None:
        t_end = what_is_left(restart, t_end)
    options.output.mkdir(parents=True, exist_ok=True)
    say = (lambda *_: None) if options.quiet else print
    say(describe_scene(scene))
    solutions, failed = {}, []
    for label, method in methods.items():
        path = options.output / (f"{stem}.h5" if len(methods) == 1 else f"{stem}_{_file_part(label)}.h5")
        try:
            solution = simulate(
                scene,
                method,
                t_end=t_end,
                **arguments,
                restart=restart,
                throw=False,
                progress=sys.stderr.isatty() and not options.quiet,
                output=ResultWriter(path, overwrite=options.overwrite),
            )
        except KeyboardInterrupt as stopped:
            if path.exists():
                print(
                    f"jaxshell: stopped; {path} holds what was computed until then. "
                    f"`jaxshell run {path} --continue` goes on with it.",
                    file=sys.stderr,
                )
            else:
                print("jaxshell: stopped before the first step.", file=sys.stderr)
            return exit_status(stopped)
        solutions[label] = solution
        say(describe_run(label, solution, path))
        if not bool(solution.result == RESULTS.successful):
            failed.append(label)
            print(f"jaxshell: {label} failed. {solution.message}", file=sys.stderr)
    if not options.no_plots:
        from jaxshell.plotting import plot

        for path in plot(solutions, options.output, stem):
            say(f"  {path}")
    return 1 if failed else 0


def _plot(options: argparse.Namespace) -> int:
    _prepare_jax()
    from jaxshell.command.method_names import method_label, parse_method
    from jaxshell.plotting import plot
    from jaxshell.results.solution import Solution

    loaded = {path: Solution.load(path) for path in options.files}
    labels = []
    for path, solution in loaded.items():
        if solution.message:
            print(f"jaxshell: {path}: {solution.message}", file=sys.stderr)
        try:
            labels.append(method_label(parse_method(solution.stats.get("method", "")), solution.scene))
        except ValueError:
            labels.append(path.stem)
    if len(set(labels)) < len(labels):
        labels = [path.stem for path in loaded]
    if len(set(labels)) < len(labels):
        labels = [str(path) for path in loaded]
    first = options.files[0]
    stem = first.stem if len(loaded) == 1 else f"{_common_stem(loaded)}_compared"
    runs = dict(zip(labels, loaded.values(), strict=True))
    for path in plot(runs, options.output or first.parent, stem, options.contour):
        print(path)
    return 0


def _chart(options: argparse.Namespace) -> int:
    one_thread_for_small_meshes(options.scene)
    _prepare_jax()
    from jaxshell.advice.chart import chart, default_window, mesh_points, write_points
    from jaxshell.plotting.work_precision import draw
    from jaxshell.scenes import PAPER

    scene, of_file, stem = open_scene(options.scene)
    dt = first_step(options, of_file, scene)
    options.output.mkdir(parents=True, exist_ok=True)
    say = (lambda *_: None) if options.quiet else lambda text: print(text, flush=True)
    points, reference = chart(scene, dt, default_window(scene, dt, options.t_end), say=say)
    if options.scene in PAPER:
        points += mesh_points(PAPER[options.scene], dt, float(reference.times[-1]), say)
    data, picture = (options.output / f"{stem}_work_precision{end}" for end in (".json", ".png"))
    write_points(data, scene, points, reference)
    draw(scene.name, points, floor=reference.uncertainty).savefig(picture, bbox_inches="tight")
    print(f"{data}\n{picture}")
    return 0


def _advise(options: argparse.Namespace) -> int:
    one_thread_for_small_meshes(options.scene)
    _prepare_jax()
    from jaxshell.advice.advise import advise
    from jaxshell.advice.text import command_line, describe, run_section
    from jaxshell.scenes import PAPER

    scene, of_file, _ = open_scene(options.scene)
    dt = first_step(options, of_file, scene)
    say = (lambda *_: None) if options.quiet else lambda text: print(text, flush=True)
    advice = advise(scene, options.tolerance, dt, options.t_end, say, make=PAPER.get(options.scene))
    print(describe(scene, advice))
    print(f"  {command_line(options.scene, advice)}")
    section = run_section(scene, advice)
    print(f"or, in a scene file,\n{section}", end="")
    if options.output is not None:
        options.output.write_text(section, encoding="utf-8")
    return 0 if advice.met else 1


def _scenes(options: argparse.Namespace) -> int:
    from jaxshell.scenes import BY_NAME

    width = max(len(name) for name in BY_NAME)
    for name, make in BY_NAME.items():
        print(f"{name:{width}}  {(make.__doc__ or '').splitlines()[0]}")
    return 0


# --- parts -----------------------------------------------------------------------------------------------


def _prepare_jax() -> None:
    """Switch double precision on, and keep compiled programs in the user's cache: the next start is quick.

    JAX_COMPILATION_CACHE_DIR names another place; JAX_ENABLE_COMPILATION_CACHE=false keeps nothing.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.config.values["jax_compilation_cache_dir"] is None:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(home / "jaxshell"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def _file_part(label: str) -> str:
    """A method's label as part of a file's name."""
    plain = label.replace("ρ∞", "rho").replace("ξ", "xi").replace(" = ", "").replace(", ", "_")
    return file_part(plain)


def _common_stem(loaded: dict) -> str:
    """The first words that all files' names share, or else the scene's name."""
    words = zip(*(path.stem.split("_") for path in loaded), strict=False)
    shared = [same[0] for same in itertools.takewhile(lambda same: len(set(same)) == 1, words)]
    return "_".join(shared) or file_part(next(iter(loaded.values())).scene.name)
