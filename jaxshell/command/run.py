"""`jaxshell run`: run a scene, write its results and pictures."""

import argparse
import sys
from pathlib import Path

from jaxshell.command.adapted import adapted
from jaxshell.command.analyses import contours_of, run_analysis
from jaxshell.command.outputs import outputs, say_besides
from jaxshell.command.run_settings import (
    arguments_of_simulate,
    chosen_methods,
    kernels_of,
    one_thread_for_small_meshes,
    open_scene,
    required,
    settled,
    solution_to_go_on_from,
    what_is_left,
    with_picture_times,
)
from jaxshell.command.start import prepare_jax
from jaxshell.files.quoted import file_part
from jaxshell.files.run_keys import add_options
from jaxshell.numerics.signals import exit_status


def add(commands) -> None:
    run = commands.add_parser("run", help="run a scene; write its results and pictures")
    run.set_defaults(command=_run)
    run.add_argument("scene", metavar="SCENE", help="a scene's name (see `jaxshell scenes`), a .toml or .h5 file")
    run.add_argument(
        "--divisions", type=int, nargs="+", metavar="N", help="divisions of the mesh (library scenes only)"
    )
    run.add_argument(
        "--refine", type=int, default=0, metavar="N", help="cut every triangle in four, N times (docs/refinement.md)"
    )
    run.add_argument(
        "--coarsen", type=int, default=0, metavar="N", help="make four triangles one, N times (docs/refinement.md)"
    )
    run.add_argument("--shape", help="flat, curved or relaxed elements, in place of the section's (docs/accuracy.md)")
    add_options(run)
    run.add_argument("--output", type=Path, default=Path("."), metavar="DIR", help="where files go (default: here)")
    run.add_argument(
        "--continue",
        dest="go_on",
        action="store_true",
        help="go on from the end of a result file, to the end it was to have or for --t-end more",
    )
    run.add_argument("--overwrite", action="store_true", help="replace a result file also where its run did not end")
    run.add_argument(
        "--vtkhdf", action="store_true", help="write a file for ParaView too, as the run goes (docs/export.md)"
    )
    run.add_argument("--no-plots", action="store_true", help="write the results only")
    run.add_argument("--quiet", action="store_true", help="print errors only")


def _run(options: argparse.Namespace) -> int:
    if options.adapt is None:
        one_thread_for_small_meshes(options.scene, options.divisions)
    prepare_jax()
    scene, of_file, stem = open_scene(options.scene, options.divisions)
    scene, stem = _changed(options, scene, stem)
    settings = settled(options, of_file, scene)
    scene = with_picture_times(scene, settings)
    analysis = str(settings.analysis)
    if analysis != (of_file.analysis or "time"):
        stem = f"{stem}_{analysis.replace('-', '_')}"
    stem = stem if options.adapt is None else f"{stem}_adapted"
    with kernels_of(settings):
        return _run_on_mesh(options, settings, scene, stem)


def _run_on_mesh(options: argparse.Namespace, settings, scene, stem: str) -> int:
    """The run on the scene's mesh, or on one that is adapted first."""
    met = True
    if settings.adapts:
        try:
            scene, met = adapted(options, settings, scene, stem)
        except KeyboardInterrupt as stopped:
            print("jaxshell: stopped while the mesh was adapted; nothing was written.", file=sys.stderr)
            return exit_status(stopped)
        except RuntimeError as error:
            print(f"jaxshell: the mesh was not adapted. {error}", file=sys.stderr)
            return 1
    run = _run_in_time if settings.analysis == "time" else run_analysis
    status = run(options, settings, scene, stem)
    return status if met else status or 1


def _changed(options: argparse.Namespace, scene, stem: str):
    """The scene of --refine, --coarsen and --shape, and the stem of its files. Raises ValueError where a run of another
    scene would go on."""
    from jaxshell.model.refinement import coarsen, refine
    from jaxshell.model.with_shape import with_shape

    given = [name for name in ("refine", "coarsen", "shape") if getattr(options, name)]
    if options.go_on and given:
        raise ValueError(
            f"--continue goes on on the mesh and with the elements that the run was made with: leave --{given[0]} out."
        )
    if options.refine:
        scene, stem = refine(scene, options.refine), f"{stem}_refined_{options.refine}"
    if options.coarsen < 0:
        raise ValueError(f"--coarsen must be a whole number of at least 0, but it is {options.coarsen}.")
    for _ in range(options.coarsen):
        scene = coarsen(scene)
    stem = f"{stem}_coarsened_{options.coarsen}" if options.coarsen else stem
    if options.shape:
        scene, stem = with_shape(scene, options.shape), f"{stem}_{options.shape}"
    return scene, stem


def _run_in_time(options: argparse.Namespace, settings, scene, stem: str) -> int:
    """The run of every method that is asked for, each into a file of its own; then the pictures of all together."""
    from jaxshell.analyses.simulation import simulate
    from jaxshell.command.pictures import PicturesAhead
    from jaxshell.command.report import describe_run, describe_scene
    from jaxshell.results.solution import RESULTS

    restart = None
    if options.go_on and settings.errors:
        raise ValueError("errors are those of a whole run: leave --continue out, or say --no-errors.")
    if options.go_on:
        restart, stem = solution_to_go_on_from(options), f"{Path(options.scene).stem}_continued"
    methods, arguments = chosen_methods(settings, scene), arguments_of_simulate(settings)
    t_end = required(settings, "t_end")
    if restart is not None and options.t_end is None:
        t_end = what_is_left(restart, t_end)
    options.output.mkdir(parents=True, exist_ok=True)
    say = (lambda *_: None) if options.quiet else print
    say(describe_scene(scene))
    solutions, failed = {}, []
    ahead = PicturesAhead(wanted=not options.no_plots)
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
                output=outputs(path, options, ahead),
            )
        except KeyboardInterrupt as stopped:
            _say_stopped(path)
            return exit_status(stopped)
        solutions[label] = solution
        if not options.quiet:
            say(describe_run(label, solution, path))
        say_besides(path, options, say)
        if not bool(solution.result == RESULTS.successful):
            failed.append(label)
            print(f"jaxshell: {label} failed. {solution.message}", file=sys.stderr)
        elif settings.errors:
            _say_errors(solution, method, t_end, arguments, say)
    ahead.wait()
    if not options.no_plots:
        _draw(solutions, restart, options.output, stem, say, contours_of(settings, scene))
    return 1 if failed else 0


def _say_errors(solution, method, t_end: float, arguments: dict, say) -> None:
    from jaxshell.analyses.simulation import simulate
    from jaxshell.command.errors import describe_errors, with_half_step

    def run(scene, dt=arguments["dt"]):
        return simulate(scene, method, t_end=t_end, **(arguments | {"dt": dt}), throw=False)

    halved = with_half_step(arguments["dt"])
    for line in describe_errors(solution.scene, solution, run, lambda scene: run(scene, halved), say):
        say(line)


def _draw(solutions: dict, restart, folder: Path, stem: str, say, contours=()) -> None:
    from jaxshell.plotting import plot
    from jaxshell.results.joined import joined

    if restart is not None:  # the whole run is drawn, from its beginning
        solutions = {label: joined(restart, solution) for label, solution in solutions.items()}
    for path in plot(solutions, folder, stem, contours):
        say(f"  {path}")


def _say_stopped(path: Path) -> None:
    if path.exists():
        print(
            f"jaxshell: stopped; {path} holds what was computed until then. "
            f"`jaxshell run {path} --continue` goes on with it.",
            file=sys.stderr,
        )
    else:
        print("jaxshell: stopped before the first step.", file=sys.stderr)


def _file_part(label: str) -> str:
    """A method's label as part of a file's name."""
    plain = label.replace("ρ∞", "rho").replace("ξ", "xi").replace(" = ", "").replace(", ", "_")
    return file_part(plain)
