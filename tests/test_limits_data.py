"""The answers of continuous problems that jaxshell ships: which scenes they are of, and how well they are known."""

import dataclasses

import numpy as np
import pytest

from jaxshell import scenes
from jaxshell.advice.limits import limit_reference

KNOWN = {
    "cap": (2.5e-4, 2e-3), "suddenly_loaded_cap": (1e-3, 2e-3), "opened_cap": (2.6, 2e-3), "plate": (0.015, 2e-3),
    "snapping_panel": (0.11, 2e-3), "flying_cylinder": (2.0, 4e-3),
}  # fmt: skip
"""Until when, and how well: docs/accuracy.md."""


@pytest.mark.parametrize("name", KNOWN)
def test_a_scene_has_its_answer_on_any_mesh_and_no_other_scene_has(name):
    make, (until, known) = scenes.BY_NAME[name], KNOWN[name]
    scene, default = make(), scenes.default_divisions(make)
    other = make(tuple(2 * n for n in default) if isinstance(default, tuple) else 2 * default)
    answers = [limit_reference(each, until) for each in (scene, other)]
    for answer in answers:
        assert answer is not None and 0 < answer.uncertainty <= known
        assert answer.times[0] == 0 and answer.times[-1] == pytest.approx(until)
        assert set(answer.signals) == set(answers[0].signals) and "continuous.py" in answer.origin
    thicker = dataclasses.replace(scene.section, thickness=1.1 * scene.section.thickness)
    assert limit_reference(dataclasses.replace(scene, section=thicker)) is None


def test_the_cap_that_is_loaded_at_once_peaks_where_others_say():
    """Bathe, Ramm & Wilson 1975 and others: -0.087 to -0.093 in."""
    answer = limit_reference(scenes.suddenly_loaded_cap(), 6e-4)
    assert answer is not None
    peak = float(np.min(answer.signals["apex"]))
    assert -0.093 <= peak <= -0.087 and peak == pytest.approx(-0.0926, abs=1e-4)
