"""Input files from anywhere: a run keeps copies of them, from which it continues on another machine."""

import json
import shutil

import pytest
from geometry.meshes import cube, write
from resume.runs import balls, files_of

from granflow.cli.main import main
from granflow.load import copied_scene, load_scene, scene_of
from granflow.runs.run_directory import RunDirectory


@pytest.fixture
def scene(tmp_path):
    """The scene `balls` with a table and particles from outside of its own folder."""
    here = tmp_path / "here"
    for name in ("scenes", "tables", "filled"):
        (here / name).mkdir(parents=True)
    (here / "tables" / "lift.csv").write_text("time [ms],displacement [mm]\n0,0\n20,-1\n")
    beads = "x,y,z,r\n0.005,0.004,0.0025,0.002\n0.015,0.004,0.0025,0.002\n"
    (here / "filled" / "beads.csv").write_text(beads)
    given = balls(run={"duration": 4e-3, "time_step": 1e-5, "velocity_max": 1.0}).to_dict()
    insertion = {"kind": "file", "file": "../filled/beads.csv"}
    given["particles"] = {"beads": {"material": "glass", "insert": insertion}}
    table = {"kind": "table", "file": "../tables/lift.csv", "direction": [0, 0, 1]}
    given["walls"]["lid"]["motion"] = [table]
    path = here / "scenes" / "beads.yaml"
    path.write_text(json.dumps(given))
    return path


def names_of(scene):
    return [name for _, name in scene.input_names()]


def test_run_continues_from_copies_of_input_files_outside_the_scene_folder(taichi_f64, scene, tmp_path):
    whole, out, there = tmp_path / "whole", tmp_path / "here" / "out", tmp_path / "there"
    assert main(["run", str(scene), "--out", str(whole), "--threads", "2"]) == 0
    assert main(["run", str(scene), "--out", str(out), "--until", "2 ms", "--threads", "2"]) == 0
    shutil.move(out, there)
    shutil.rmtree(tmp_path / "here")
    written = load_scene(there / "scene_as_run.yaml")
    assert names_of(written) == ["inputs/lift.csv", "inputs/beads.csv"] and copied_scene(written) is written
    assert main(["resume", str(there), "--threads", "2"]) == 0
    assert files_of(there) == files_of(whole)


def test_copies_are_numbered_and_keep_clear_of_results_and_links_are_followed(scene, tmp_path):
    """Three meshes box.stl: an absolute path, a link in the folder of the scene, and a relative path; a table with
    the name of a result; and a sieve curve, which the scene keeps without its file."""
    files = {"parts/box.stl": 1.0, "linked.stl": 1.01, "other/box.stl": 1.02}
    for name, height in files.items():
        points, corners = cube()
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write(tmp_path / name, points * [1.0, 1.0, height], corners)
    (scene.parent / "box.stl").symlink_to(tmp_path / "linked.stl")
    shutil.copy(tmp_path / "here" / "tables" / "lift.csv", scene.parent / "timeseries.csv")
    given = (str(tmp_path / "parts" / "box.stl"), "box.stl", "../../other/box.stl")
    overrides = [f"walls.w{k}={{shape: mesh, file: {name}, material: glass}}" for k, name in enumerate(given)]
    (tmp_path / "sieves.csv").write_text("opening [mm],passing [%]\n3,0\n4,40\n5,100\n")
    region = "{box: {min: [0, 0, 1 cm], max: [2 cm, 2 cm, 2 cm]}}"
    sieved = "diameter: {distribution: sieve, file: ../../sieves.csv}"
    overrides += [
        "walls.lid.motion.0.file=timeseries.csv",
        f"particles.grit={{material: glass, count: 5, {sieved}, insert: {{kind: lattice, region: {region}}}}}",
    ]
    scene = load_scene(scene, overrides)
    copied = copied_scene(scene)
    copies = ["inputs/box.stl", "box.stl", "inputs/box_2.stl"]
    assert set(names_of(copied)) == {
        *copies,
        *(f"inputs/{name}.csv" for name in ("timeseries", "beads", "sieves")),
    }
    elsewhere = scene_of(copied.to_yaml(), str(tmp_path / "there" / "scene.yaml"))
    assert elsewhere.particles["grit"].size_spans() == [(0.003, 0.005)]
    out = tmp_path / "out"
    directory = RunDirectory(out, scene, None)
    directory.create()
    with directory.open([]):
        for copy, original in zip(copies, files, strict=True):
            assert (out / copy).read_bytes() == (tmp_path / original).read_bytes()
            assert not (out / copy).is_symlink()
