"""Suggestions for names of other codes, and overrides whose path is the same in scenes and resolved
scenes."""

from pathlib import Path

import pytest
from plan.scenes import scene_of

from granflow.errors import SceneError
from granflow.load import Scene, load_scene
from granflow.schema.messages import SYNONYMS, nearest

SCENES = Path(__file__).parents[2] / "scenes"


@pytest.mark.parametrize(("override", "suggestion"), [
    ("contact.normal=hertz-mindlin", "Did you mean hertz?"),
    ("contact.tangential=hertz-mindlin", "Did you mean mindlin?"),
    ("contact.cohesion=simplified_jkr", "Did you mean sjkr?"),
    ("contact.normal=hooke", "Did you mean linear?"),
    ("particles.beads.insert={kind: random}", "Did you mean pack?"),
    ("particles.beads.insert={kind: insert/stream}", "Did you mean inlet?"),
    ("walls.floor.shape=fix wall/gran", "Did you mean plane?"),
    ("materials.glass.youngsModulus=1e7", "Did you mean young_modulus?"),
    ("pairs.glass-glass.coefficientFriction=0.5", "Did you mean friction?"),
    ("run.dt=1e-5", "Did you mean time_step?"),
    ("walls.floor.motion={kind: wiggle}", "Did you mean vibration?"),
    ("contact.rolling=epsd2", "Did you mean epsd?"),
    ("contact.normal=hooke/hysteresis", "Did you mean luding?"),
    ("contact.normal=edinburgh", "Did you mean eepa?"),
    ("pairs.glass-glass.en=0.8", "Did you mean restitution?"),
    ("pairs.glass-glass.xmu=0.3", "Did you mean friction?"),
    ("thermo=100", "Did you mean output?"),
    ("boundary=p", "Did you mean domain?"),
    ("contact.normal=hertz/material", "Did you mean hertz?"),
    ("contact.tangential=linear_history",
     "linear_history requires stiffness, such as {law: linear_history, sti"),
    ("contact.normal=jkr", "jkr is given as contact.cohesion: jkr"),
    ("pairs.glass-glass={restitution: 0.9, friction: 0,3}", "Numbers have a decimal point, not a comma")
])  # fmt: skip
def test_names_of_other_codes_are_recognized(tmp_path, override, suggestion):
    with pytest.raises(SceneError) as refused:
        scene_of(tmp_path, override)
    assert suggestion in str(refused.value)


def test_synonyms_are_in_the_form_in_which_they_are_searched():
    assert all(word.isalnum() and word == word.lower() for word in SYNONYMS)
    assert (
        nearest("Fix wall/gran", ["walls", "pairs"]) == "walls"
        and nearest("fix_wall_gran", ["pairs"]) is None
    )


@pytest.mark.parametrize("override", [
    "walls.shell.motion.angular_velocity=2", "walls.shell.motion.0.angular_velocity=2",
    "contact.normal.damping_ratio=0.1", "contact.normal=hertz", "pairs.steel-glass.friction=0.2",
    "run.duration=3 s", "output.contacts=true"
])  # fmt: skip
def test_overrides_have_the_same_path_in_a_scene_and_in_its_resolved_form(tmp_path, override):
    """`granflow resume` applies overrides to scene_as_run.yaml."""
    resolved = tmp_path / "scene_as_run.yaml"
    resolved.write_text(load_scene(SCENES / "drum.yaml").to_yaml())
    first, second = (load_scene(path, [override]) for path in (SCENES / "drum.yaml", resolved))
    assert first.to_yaml() == second.to_yaml() != load_scene(SCENES / "drum.yaml").to_yaml()
    assert isinstance(first, Scene)
