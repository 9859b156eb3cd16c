"""Clumps whose spheres are in a file: formats, messages, and the scene that a run saves."""

import pytest
from particles.scenes import BOX
from particles.scenes import scene_with as scene_of_groups

from granflow import SceneError
from granflow.load import scene_of

SPHERES = [
    {"position": [0.0, 0.0, 0.0], "radius": 0.002},
    {"position": [0.003, 0.0, 0.0], "radius": 0.0015},
    {"position": [0.0, 0.0025, -0.001], "radius": 0.001},
]
ROWS = ((0.0, 0.0, 0.0, 2.0), (3.0, 0.0, 0.0, 1.5), (0.0, 2.5, -1.0, 1.0))
"""The same spheres in mm."""


def rows(separator, *columns):
    return "".join(separator.join(str(row[k]) for k in columns) + "\n" for row in ROWS)


FILES = {
    "liggghts.txt": "# stone\n" + rows("  ", 0, 1, 2, 3),
    "comment.csv": "# x y z r, mm\n" + rows(",", 0, 1, 2, 3),
    "tabs.txt": rows("\t", 0, 1, 2, 3),
    "header.csv": "radius;z;y;x\n" + rows(";", 3, 2, 1, 0),
    "spreadsheet.csv": "sep=;\n" + rows(";", 0, 1, 2, 3).replace(".", ","),
    "units.csv": "x [mm],y [mm],z [mm],r [mm]\n" + rows(",", 0, 1, 2, 3),
}


def scene_with(clump, folder):
    stones = {"mass": 0.1, "clump": clump, "insert": {"kind": "pack", "region": BOX}}
    return scene_of_groups({"stones": stones}, folder=folder)


@pytest.mark.parametrize("name", FILES)
def test_the_spheres_of_a_file_are_those_of_the_scene(name, tmp_path):
    (tmp_path / name).write_text(FILES[name])
    scale = 1.0 if name == "units.csv" else 0.001
    found = scene_with({"file": name, "scale": scale}, tmp_path).particles["stones"]
    expected = scene_with({"spheres": SPHERES}, tmp_path).particles["stones"]
    assert [each.radius for each in found.clump.spheres] == pytest.approx([0.002, 0.0015, 0.001])
    assert found.clump.body.volume == pytest.approx(expected.clump.body.volume, rel=1e-12)
    assert found.clump.outer_diameter == pytest.approx(expected.clump.outer_diameter, rel=1e-12)
    assert found.count == expected.count > 500


def test_a_saved_scene_has_the_spheres_and_the_path_of_the_file(tmp_path):
    (tmp_path / "stone.txt").write_text(FILES["liggghts.txt"])
    scene = scene_with({"file": "stone.txt", "scale": 0.002}, tmp_path)
    assert list(scene.input_names()) == [("particles.stones.clump.file", "stone.txt")]
    text = scene.to_yaml()
    (tmp_path / "stone.txt").unlink()
    again = scene_of(text, str(tmp_path / "scene_as_run.yaml"))
    assert again.particles == scene.particles
    assert again.particles["stones"].clump.spheres[1].position == pytest.approx((0.006, 0.0, 0.0))


CASES = [
    ("x,y,z,r\n0,0,0,1e-3\n1e-3,0,0,-1\n", "stone.csv:3: the radius must be above 0."),
    ("x y z r\n0 0 0 1\n1; 0 0 1\n", "stone.csv:3: x is '1;', but a number is expected."),
    ("0 0 0 1\n1 0 0\n", "stone.csv:2: the row has 3 values, but x, y, z, r are expected."),
    ("0 0 0 1\n1 0 0 1e300\n", "stone.csv:2: a length of this magnitude is out of range."),
    ("", "stone.csv: the file contains no spheres."),
    ("0 0 0 1\n" * 101, "particles.stones.clump.file is stone.csv, which cannot be used: it has 101 spheres"),
    (None, "particles.stones.clump.file is stone.csv, which cannot be used: there is no such file"),
]


@pytest.mark.parametrize(("text", "sentence"), CASES)
def test_a_file_that_is_not_valid_has_its_message(text, sentence, tmp_path):
    if text is not None:
        (tmp_path / "stone.csv").write_text(text)
    with pytest.raises(SceneError) as error:
        scene_with({"file": "stone.csv"}, tmp_path)
    assert any(sentence in each for each in error.value.problems), error.value.problems


def test_a_clump_has_spheres_or_a_file(tmp_path):
    with pytest.raises(SceneError, match="clump.spheres is missing: centers and radii"):
        scene_with({"orientation": "random"}, tmp_path)
    with pytest.raises(SceneError, match="clump.scale is 2, but it belongs to a file"):
        scene_with({"spheres": SPHERES, "scale": 2}, tmp_path)
