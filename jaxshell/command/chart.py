"""`jaxshell chart`: error against time for every choice, drawn: of mesh and step together, and of the step alone."""

import argparse
from pathlib import Path

from jaxshell.command.run_settings import first_step, one_thread_for_small_meshes, open_scene
from jaxshell.command.start import prepare_jax
from jaxshell.command.trials import add_options


def add(commands) -> None:
    chart = commands.add_parser("chart", help="draw error against time for every choice, and the best of them")
    chart.set_defaults(command=_chart)
    chart.add_argument("--output", type=Path, default=Path("."), metavar="DIR", help="where files go (default: here)")
    add_options(chart)
    chart.add_argument(
        "--budget", type=float, default=120.0, metavar="S", help="seconds for the continuous answer, about (120)"
    )


def _chart(options: argparse.Namespace) -> int:
    one_thread_for_small_meshes(options.scene)
    prepare_jax()
    from jaxshell.advice.chart import chart, default_window, write_points
    from jaxshell.advice.total import total_points
    from jaxshell.plotting.work_precision import draw
    from jaxshell.scenes import BY_NAME

    scene, of_file, stem = open_scene(options.scene)
    dt = first_step(options, of_file, scene)
    options.output.mkdir(parents=True, exist_ok=True)
    say = (lambda *_: None) if options.quiet else lambda text: print(text, flush=True)
    window = default_window(scene, dt, options.t_end)
    total, found = total_points(scene, dt, window, BY_NAME.get(options.scene), options.budget, say)
    points, reference = chart(scene, dt, window, say=say)
    data, picture = (options.output / f"{stem}_work_precision{end}" for end in (".json", ".png"))
    write_points(data, scene, total + points, reference, found.reference)
    floors = reference.uncertainty, found.reference.uncertainty
    draw(scene.name, total + points, floor=floors[0], whole_floor=floors[1]).savefig(picture, bbox_inches="tight")
    print(f"{data}\n{picture}")
    return 0
