"""Result files that version 0.1 wrote (tests/data/version_0_1_*.h5) open, and a run goes on from them.

They are of a clamped strip of two triangles under an edge force and a pressure, 20 steps of 0.01.
"""

from pathlib import Path

import numpy as np
import pytest

import jaxshell as js

DATA = Path(__file__).parent / "data"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method"),
    [("plain", js.EnergyMomentum()), pytest.param("reactions", js.GeneralizedEnergyMomentum(), marks=pytest.mark.slow)],
)
def test_run_goes_on(name, method):
    """As a run of this version that was never stopped: within 1e-9, ten times less than Newton's tolerance."""
    before, recorded = js.Solution.load(DATA / f"version_0_1_{name}.h5"), name == "reactions"
    options = {"dt": 0.01, "save_every": 5, "reactions": recorded}
    whole = js.simulate(before.scene, method, t_end=0.4, **options)
    rest = js.simulate(before.scene, method, t_end=0.2, restart=before, **options)
    assert before.analysis == "time" and len(before.times) == 21
    np.testing.assert_allclose(before.displacements, whole.displacements[:5], atol=1e-9)
    np.testing.assert_allclose(rest.times, whole.times[20:], atol=1e-15)
    np.testing.assert_allclose(rest.displacements, whole.displacements[4:], atol=1e-9)
    np.testing.assert_allclose(rest.energy.external_work, whole.energy.external_work[20:], rtol=1e-8)
    if recorded:
        expected = np.asarray(js.reactions(whole))[20:]
        # The file's state carries what its version's Newton left, 5e-11 in displacements whatever this one's tolerance
        # is: in stiff directions 3e-6 of the largest reaction.
        np.testing.assert_allclose(js.reactions(rest), expected, atol=1e-5 * np.abs(expected).max())


def test_statics_knows_its_reactions():
    static = js.Solution.load(DATA / "version_0_1_static.h5")
    assert static.analysis == "static"
    again = js.solve_static(static.scene)
    np.testing.assert_allclose(static.displacements, again.displacements, atol=1e-10)
    carried, expected = np.asarray(js.reactions(static)), np.asarray(js.reactions(again))
    np.testing.assert_allclose(carried, expected, atol=1e-9 * np.abs(expected).max())
