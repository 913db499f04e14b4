"""Equilibrium of a static solution as a whole: applied and reaction forces, and their moments."""

import jax.numpy as jnp
import numpy as np

import jaxshell as js
from jaxshell.analyses.statics import proportional
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse


def imbalance(solution) -> float:
    """Largest resultant force and moment of loads and reactions over all frames, relative to the sums of their sizes.

    Moments about the middle of the shell; a moment counts as a force over the size of the shell and the reverse.
    """
    tables, _ = analyse(structure_of(solution.scene))
    model = Model.build(proportional(solution.scene), tables)
    x0, size = np.asarray(model.x0), float(model.size)
    carried = np.asarray(js.reactions(solution))
    worst = 0.0
    for k, factor in enumerate(np.asarray(solution.frame_times)):
        x = x0 + np.asarray(solution.displacements[k])
        applied = np.asarray(model.external_load(jnp.asarray(x), jnp.asarray(solution.rotations[k]), factor))
        scale = sum(np.abs(f[:, :3]).sum() + np.abs(f[:, 3:]).sum() / size for f in (applied, carried[k]))
        total = applied + carried[k]
        moment = (np.cross(x - x0.mean(axis=0), total[:, :3]) + total[:, 3:]).sum(axis=0)
        if scale > 0:
            worst = max(worst, np.abs(total[:, :3].sum(axis=0)).max() / scale, np.abs(moment).max() / (scale * size))
    return worst
