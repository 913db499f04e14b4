"""`jaxshell advise`: the cheapest way to run a scene to a tolerance."""

import argparse
from pathlib import Path

from jaxshell.command.run_settings import first_step, one_thread_for_small_meshes, open_scene
from jaxshell.command.start import prepare_jax
from jaxshell.command.trials import add_options


def add(commands) -> None:
    advise = commands.add_parser("advise", help="find the cheapest way to run a scene to a tolerance")
    advise.set_defaults(command=_advise)
    advise.add_argument("--tolerance", type=float, default=1e-2, help="relative error allowed (default: 0.01)")
    advise.add_argument("--output", type=Path, metavar="FILE", help="write the scene file's tables here too")
    advise.add_argument("--budget", type=float, default=110.0, metavar="S", help="seconds to spend, about (110)")
    add_options(advise)


def _advise(options: argparse.Namespace) -> int:
    one_thread_for_small_meshes(options.scene)
    prepare_jax()
    from jaxshell.advice.advise import advise
    from jaxshell.advice.text import command_line, describe, file_tables
    from jaxshell.scenes import BY_NAME

    scene, of_file, _ = open_scene(options.scene)
    dt = first_step(options, of_file, scene)
    say = (lambda *_: None) if options.quiet else lambda text: print(text, flush=True)
    advice = advise(scene, options.tolerance, dt, options.t_end, say, BY_NAME.get(options.scene), options.budget)
    print(describe(scene, advice))
    print(f"  {command_line(options.scene, advice)}")
    tables = file_tables(scene, advice)
    print(f"or, in a scene file,\n{tables}", end="")
    if options.output is not None:
        options.output.write_text(tables, encoding="utf-8")
    return 0 if advice.met else 1
