"""`jaxshell sweep`: run a scene file with many values of some of its keys."""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from jaxshell.command.run_settings import (
    arguments_of_simulate,
    chosen_methods,
    one_thread_for_small_meshes,
    required,
    settled,
)
from jaxshell.command.start import prepare_jax
from jaxshell.files.run_keys import KEYS, add_options
from jaxshell.numerics.signals import exit_status

_STEPS = ("run.dt", "run.t_end", "run.step_")
"""Beginnings of the keys that give members different steps."""
_REASONS = 5
"""So many failed members are named one by one."""


def add(commands) -> None:
    sweep = commands.add_parser("sweep", help="run a scene file with many values of some of its keys")
    sweep.set_defaults(command=_sweep)
    sweep.add_argument("scene", metavar="SCENE.toml", help="a scene file")
    sweep.add_argument(
        "--vary",
        action="append",
        required=True,
        metavar="KEY=VALUES",
        help="a key by its dotted path and what it runs through: section.thickness=0.3:0.5:20, loads.1.force.3=1,2,4, "
        '"materials.steel.density=normal(7800, 50)", section.young_modulus=x0.9:1.1:5 (factors); may be repeated',
    )
    sweep.add_argument(
        "--sample",
        default="grid",
        metavar="KIND",
        help="grid (all combinations, the default), zip, latin:N, sobol:N, random:N or saltelli:N",
    )
    sweep.add_argument("--seed", type=int, default=0, metavar="N", help="of a sample (default: 0)")
    sweep.add_argument("--output", type=Path, metavar="FILE.h5", help="the file (default: SCENE_sweep.h5, here)")
    sweep.add_argument("--overwrite", action="store_true", help="replace what the file holds")
    sweep.add_argument("--batch", type=int, default=16, metavar="K", help="members of a program, at most (default: 16)")
    sweep.add_argument("--workers", type=int, default=1, metavar="N", help="processes on this machine (default: 1)")
    sweep.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, such as tcp://host:8786")
    sweep.add_argument("--points", type=int, metavar="N", help="times of the histories kept (default: every step)")
    sweep.add_argument("--frames", action="store_true", help="keep frames too, every --save-every steps")
    sweep.add_argument(
        "--quantity",
        action="append",
        metavar="WHAT",
        help='what sensitivities are of: "tip max", "tip min", "tip end" of a watched tip; may be repeated',
    )
    sweep.add_argument("--no-plots", action="store_true", help="write the results only")
    sweep.add_argument("--quiet", action="store_true", help="print errors only")
    add_options(sweep)


def _sweep(options: argparse.Namespace) -> int:
    one_thread_for_small_meshes(options.scene)
    prepare_jax()
    from jaxshell.analyses.sweep.design import design
    from jaxshell.analyses.sweep.run import run_sweep
    from jaxshell.command.sweep_report import describe_design, describe_sweep

    _check(options)
    axes = _axes(options.vary)
    plan = design(axes, options.sample, options.seed)
    cases = _Cases(options, {name for name, axis in axes.items() if axis.factor})
    cases.check(plan)
    output = options.output or Path(f"{Path(options.scene).stem}_sweep.h5")
    say = (lambda *_: None) if options.quiet else lambda text: print(text, flush=True)
    say(describe_design(cases.name, plan, axes, options.sample, options.seed))
    begun = time.perf_counter()
    try:
        sweep = run_sweep(
            plan,
            cases,
            alike=not any(name.startswith(_STEPS) for name in axes) and not cases.controlled,
            same_end="run.t_end" not in axes,
            asked={
                "sample": options.sample,
                "seed": options.seed,
                "vary": {name: axis.text for name, axis in axes.items()},
                "factors": sorted(cases.factors),
            },
            times=options.points,
            quantities={},
            save_every=cases.save_every if options.frames else None,
            batch=options.batch,
            workers=options.workers,
            scheduler=options.scheduler,
            output=output,
            overwrite=options.overwrite,
            say=say,
        )
    except KeyboardInterrupt as stopped:
        kept = f"{output} holds the members that ended" if output.exists() else "no member has ended"
        print(f"jaxshell: stopped; {kept}. The same command goes on with it.", file=sys.stderr)
        return exit_status(stopped)
    except RuntimeError as error:
        print(f"jaxshell: {error}", file=sys.stderr)
        return 1
    say(describe_sweep(sweep, output, options.quantity, time.perf_counter() - begun))
    for number in sorted(sweep.messages)[:_REASONS]:
        print(f"jaxshell: member {number} failed. {sweep.messages[number]}", file=sys.stderr)
    if not options.no_plots and sweep.successful.any():
        from jaxshell.plotting.ensembles import plot_sweep

        for path in plot_sweep(sweep, output.parent, output.stem, options.quantity):
            say(f"  {path}")
    return 0 if sweep.successful.any() else 1


def _check(options: argparse.Namespace) -> None:
    """Raise ValueError for options that do not go together."""
    if Path(options.scene).suffix != ".toml":
        raise ValueError(
            f"A sweep varies the keys of a scene file, a .toml, but the scene is {options.scene!r}. In Python "
            "jaxshell.sweep varies any scene."
        )
    if options.method and (len(options.method) > 1 or "all" in options.method):
        raise ValueError("A member is run by one method: vary it, as in --vary run.method=EMC,exact.")
    if options.reactions:
        raise ValueError("A sweep keeps no reactions: run the members that matter with `jaxshell run`.")


def _axes(said: list[str]) -> dict[str, Any]:
    """{key: what it runs through}. Raises ValueError for a text that is no KEY=VALUES, and for a key said twice."""
    from jaxshell.analyses.sweep.varied import varied

    found = {}
    for text in said:
        name, equals, values = text.partition("=")
        name = name.strip()
        if not equals or not name or not values.strip():
            raise ValueError(f"--vary takes KEY=VALUES, such as section.thickness=0.3:0.5:20, but it is {text!r}.")
        if name in found:
            raise ValueError(f"--vary names {name} twice.")
        found[name] = varied(name, values)
    return found


class _Cases:
    """Makes the case of a member: the scene file with its values, run as the command line and the file say."""

    def __init__(self, options: argparse.Namespace, factors: set[str]):
        from jaxshell.files.imperfection import IMPERFECTION
        from jaxshell.files.scene_file import REFINE, read_content, scene_of

        self.options, self.factors = options, frozenset(factors)
        self.content = read_content(options.scene)
        scene, settings = scene_of(self.content, options.scene)
        self.name = scene.name
        settings = settled(options, settings, scene)
        if settings.adapts:
            raise ValueError("A sweep runs all members on one mesh: leave adapt and goal out, or adapt each by itself.")
        self.controlled, self.save_every = settings.step_tolerance is not None, settings.save_every
        # The modes of an imperfection are each member's own.
        made_anew = IMPERFECTION in self.content["mesh"] or REFINE in self.content["mesh"]
        self.mesh = None if made_anew else scene.mesh
        self.responses = [f"{label} {word}" for label, _, _ in scene.watch for word in ("min", "max", "end")]

    def check(self, plan) -> None:
        """Raise ValueError for keys that the file does not have, or that the command line holds fast, and quantities
        that it does not watch."""
        from jaxshell.files.dotted import with_values

        with_values(self.content, plan.member(0), self.factors)
        for name in plan.parameters:
            key = name.removeprefix("run.")
            if name.startswith("run.") and key in KEYS and getattr(self.options, key) is not None:
                raise ValueError(f"{name} varies, but --{key.replace('_', '-')} holds it fast: leave one of them out.")
            if name.startswith("run.") and key in ("save_every", "picture_times", "reactions"):
                raise ValueError(f"{name} changes nothing that a sweep keeps.")
        for what in self.options.quantity or ():
            if what not in self.responses:
                known = ", ".join(self.responses) or "none, since the file watches nothing"
                raise ValueError(f"There is no quantity {what!r}. Choose out of {known}.")
        if any(name.startswith("mesh.") for name in plan.parameters):
            self.mesh = None

    def __call__(self, parameters: dict[str, Any]):
        from jaxshell.analyses.sweep.member import Case, Options
        from jaxshell.files.dotted import with_values
        from jaxshell.files.scene_file import scene_of

        content = with_values(self.content, parameters, self.factors)
        scene, of_file = scene_of(content, self.options.scene, self.mesh)
        settings = settled(self.options, of_file, scene)
        methods = chosen_methods(settings, scene)
        if len(methods) > 1:
            raise ValueError("A member is run by one method: vary it, as in --vary run.method=EMC,exact.")
        how = arguments_of_simulate(settings)
        solved = Options(how["newton"], how["tangent"], how["linear_solver"], settings.kernels or "xla")
        return Case(scene, next(iter(methods.values())), how["dt"], required(settings, "t_end"), solved)
