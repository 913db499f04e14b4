"""Pictures by VTK, off-screen, in a process of its own: what a driver prints, hangs or breaks is not ours then.

Run as a script, this file is that process: it reads jobs from its input and writes pictures to its output, each a
pickle, until its input ends or nothing is asked for a minute. It imports nothing of jaxshell.
"""

import atexit
import contextlib
import functools
import os
import pickle
import subprocess
import sys
import threading
from typing import Any

import numpy as np

_PATIENCE = 60.0
"""Seconds that a picture may take; the first one also loads VTK."""
_IDLE = 60.0
LIGHT = np.array([-0.64, 0.48, 0.6])
"""Where the light is, seen by the viewer: left, above and behind them; so low that shallow shells have shades."""
AMBIENT = 0.62


class RenderingFailed(RuntimeError):
    """VTK gave no picture."""


def shade(corners: np.ndarray) -> np.ndarray:
    """(m,) brightness of triangles with corners (m, 3, 3) in coordinates of the view; either side is lit alike."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals *= np.sign(normals[:, 2:] + 0.5 * (normals[:, 2:] == 0))
    size = np.linalg.norm(normals, axis=1)
    return AMBIENT + (1 - AMBIENT) * np.maximum(normals @ LIGHT, 0.0) / np.where(size > 0, size, 1.0)


def image(job: dict[str, Any]) -> np.ndarray:
    """(height, width, 3) picture of a job: corners (m, 3, 3) in coordinates of the view, values (m, 3) at them,
    colours (k, 4) of the values between the limits, window, pixels, and whether lines of the mesh are drawn.

    Raises RenderingFailed, with what VTK said, where there is no picture within a minute; and at once from then on.
    """
    with _lock:
        global _process, _broken
        if _broken:
            raise RenderingFailed(_broken)
        if _process is None or _process.poll() is not None:
            _process = _started()
        # Kills a process that hangs, so that reading from it ends.
        alarm = threading.Timer(_PATIENCE, _process.kill)
        alarm.start()
        try:
            assert _process.stdin is not None and _process.stdout is not None
            pickle.dump(job, _process.stdin)
            _process.stdin.flush()
            answer = pickle.load(_process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            answer = f"VTK ended without a picture ({error or type(error).__name__})."
        finally:
            alarm.cancel()
        if isinstance(answer, str):
            _stop()
            _broken = answer
            raise RenderingFailed(answer)
        return answer


_lock = threading.Lock()
_process: subprocess.Popen | None = None
_broken = ""
"""Why VTK does not render here, once that is known."""


def _started() -> subprocess.Popen:
    # -P: this file's folder is not searched for modules, some of whose names are those of others.
    command = [sys.executable, "-P", os.path.abspath(__file__)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


@atexit.register
def _stop() -> None:
    global _process
    if _process is not None:
        _process.kill()
        _process.wait()
        for pipe in (_process.stdin, _process.stdout):
            with contextlib.suppress(OSError):  # a job that nobody takes any more
                assert pipe is not None
                pipe.close()
        _process = None


def _serve() -> None:
    """Answer jobs with pictures, or with a text that says what failed."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # What VTK prints is no answer.
    while True:
        alarm = threading.Timer(_IDLE, os._exit, (0,))
        alarm.daemon = True
        alarm.start()
        try:
            job = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        finally:
            alarm.cancel()
        try:
            answer = _rendered(job)
        except Exception as error:
            answer = f"VTK failed: {type(error).__name__}: {error}"
        pickle.dump(answer, answers)
        answers.flush()


def _rendered(job: dict[str, Any]) -> np.ndarray:
    import pyvista

    left, bottom, right, top = job["window"]
    size = max(right - left, top - bottom)
    middle = np.array([0.5 * (left + right), 0.5 * (bottom + top), job["corners"][:, :, 2].mean()])
    points = ((job["corners"] - middle) / size).reshape(-1, 3)  # of size 1: VTK computes in single precision
    mesh = pyvista.PolyData(points, faces=_faces(len(points)))
    mesh.point_data["values"] = job["values"].ravel()
    plotter = _plotter()
    plotter.clear_actors()
    plotter.window_size = list(job["pixels"])
    actor = plotter.add_mesh(
        mesh,
        scalars="values",
        clim=list(job["limits"]),
        cmap=pyvista.LookupTable(values=job["colours"]),
        show_scalar_bar=False,
        show_edges=job["lines"],
        line_width=1,
        ambient=AMBIENT,
        diffuse=1 - AMBIENT,
        specular=0.0,
        render=False,
    )
    actor.mapper.scalar_range = job["limits"]
    actor.prop.edge_color = "black"
    actor.prop.edge_opacity = 0.3
    depth = float(np.abs(points[:, 2]).max()) + 1.0
    plotter.camera.parallel_projection = True
    plotter.camera.position, plotter.camera.focal_point, plotter.camera.up = (0, 0, depth), (0, 0, 0), (0, 1, 0)
    plotter.camera.parallel_scale = 0.5 * (top - bottom) / size
    plotter.camera.clipping_range = (0.5, 2 * depth)
    plotter.render()
    return np.asarray(plotter.screenshot(return_img=True))[..., :3]


@functools.cache
def _plotter() -> Any:
    """The window that all pictures are rendered in: a new one for each would take four times as long."""
    import pyvista

    theme = pyvista.themes.DocumentTheme()
    theme.background = "white"
    plotter = pyvista.Plotter(off_screen=True, lighting="none", theme=theme)
    plotter.add_light(pyvista.Light(position=tuple(LIGHT), focal_point=(0, 0, 0), light_type="scene light"))
    return plotter


def _faces(count: int) -> np.ndarray:
    faces = np.empty((count // 3, 4), int)
    faces[:, 0], faces[:, 1:] = 3, np.arange(count).reshape(-1, 3)
    return faces.ravel()


if __name__ == "__main__":
    _serve()
