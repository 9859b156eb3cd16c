"""Suggestions for names of other codes, and overrides with the same path in scenes and resolved scenes."""

from pathlib import Path

import pytest
from plan.scenes import scene_of

from granflow.errors import SceneError
from granflow.load import load_scene

DRUM = Path(__file__).parents[2] / "scenes/drum.yaml"


@pytest.mark.parametrize(("override", "suggestion"), [
    ("contact.normal=hertz-mindlin", "Did you mean hertz?"),
    ("contact.cohesion=simplified_jkr", "Did you mean sjkr?"),
    ("particles.beads.insert={kind: insert/stream}", "Did you mean inlet?"),
    ("walls.floor.shape=fix wall/gran", "Did you mean plane?"),
    ("materials.glass.youngsModulus=1e7", "Did you mean young_modulus?"),
    ("run.dt=1e-5", "Did you mean time_step?"),
    ("walls.floor.motion={kind: wiggle}", "Did you mean vibration?"),
    ("pairs.glass-glass.xmu=0.3", "Did you mean friction?"),
    ("boundary=p", "Did you mean domain?"),
    ("contact.tangential=linear_history", "linear_history requires stiffness, such as {law: linear_history, sti"),
    ("contact.normal=jkr", "jkr is given as contact.cohesion: jkr"),
    ("pairs.glass-glass={restitution: 0.9, friction: 0,3}", "Numbers have a decimal point, not a comma"),
])  # fmt: skip
def test_names_of_other_codes_are_recognized(tmp_path, override, suggestion):
    with pytest.raises(SceneError) as refused:
        scene_of(tmp_path, override)
    assert suggestion in str(refused.value)


@pytest.mark.parametrize("override", [
    "walls.shell.motion.angular_velocity=2", "walls.shell.motion.0.angular_velocity=2",
    "contact.normal.damping_ratio=0.1", "contact.normal=hertz", "pairs.steel-glass.friction=0.2",
])  # fmt: skip
def test_overrides_have_the_same_path_in_a_scene_and_in_its_resolved_form(tmp_path, override):
    """`granflow resume` applies overrides to scene_as_run.yaml."""
    resolved = tmp_path / "scene_as_run.yaml"
    resolved.write_text(load_scene(DRUM).to_yaml())
    first, second = (load_scene(path, [override]) for path in (DRUM, resolved))
    assert first.to_yaml() == second.to_yaml() != load_scene(DRUM).to_yaml()
