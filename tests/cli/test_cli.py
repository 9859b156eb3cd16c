"""Arguments and exit codes of the command line, and output directories that cannot be used."""

import re
from pathlib import Path

import pytest
from geometry.meshes import cube, write
from plan.scenes import TEXT

from granflow.cli.main import main
from granflow.errors import GranflowError


@pytest.fixture(autouse=True)
def scene(tmp_path, monkeypatch):
    """The file beads.yaml in the working directory."""
    monkeypatch.chdir(tmp_path)
    Path("beads.yaml").write_text(TEXT)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bake"], "invalid choice: 'bake'"),
        (["run", "a.yaml", "--threads", "0"], "0 is not a number of threads"),
        (["run", "a.yaml", "--until", "4 mm"], "argument --until: 4 mm: "),
        (["run", "a.yaml", "--until", "nan"], "nan is not finite"),
        (["run", "a.yaml", "--until=-1 s"], "argument --until: -1 s is negative"),
        (["collide", "--wall", "--diameter2", "1mm"], "not allowed with argument --wall"),
    ],
)
def test_invalid_arguments_are_rejected(arguments, message, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def test_version_is_printed_unless_the_environment_is_invalid(monkeypatch, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert re.fullmatch(r"granflow \S+ \((taichi|quadrants) [\d.]+\)\n", capsys.readouterr().out)

    def refuse(_):
        raise GranflowError("GRANFLOW_KERNELS is foo.")

    monkeypatch.setattr("granflow.io.log.version_of", refuse)
    assert main(["--version"]) == 2
    assert capsys.readouterr().err == "granflow: GRANFLOW_KERNELS is foo.\n"


def test_run_passes_its_options_to_the_simulation(monkeypatch, capsys):
    given = {}

    def record(scene, **options):
        given.update(options, precision=scene.run.precision, seed=scene.seed)
        raise GranflowError("There is no CUDA here.")

    monkeypatch.setattr("granflow.simulation.Simulation", record)
    options = "--set seed=7 --arch cuda --precision f32 --threads 3 --out here --allow-long"
    assert main(["run", "beads.yaml", *options.split()]) == 2
    expected = {"seed": 7, "arch": "cuda", "precision": "f32", "threads": 3, "out": Path("here")}
    unset = {"overwrite": False, "allow_changes": False, "resume": None, "communicator": None}
    assert given == expected | unset | {"allow_long": True, "progress": True}
    assert capsys.readouterr().err == "granflow: There is no CUDA here.\n"
    assert main(["run", "beads.yaml"]) == 2
    assert given["out"] == Path("out/beads") and given["threads"] is None


@pytest.mark.parametrize(
    ("out", "reason"),
    [
        ("beads.yaml", "this is a file, but a directory is needed"),
        ("link", "this is a link to nowhere, which does not exist"),
        ("/dev/null/out", "Not a directory"),
    ],
)
def test_an_output_directory_that_cannot_be_made_is_refused(taichi_f64, capsys, out, reason):
    Path("link").symlink_to("nowhere")
    # Studies refuse it before their first simulation.
    for command in (["run", "beads.yaml", "--threads", "2"], ["paper"], ["accuracy"], ["stability"]):
        assert main([*command, "--out", out]) == 2
        assert f"{out}: {reason}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("start_from", "link"),
        ("walls.bowl", "{shape: mesh, file: link/bowl.stl, material: glass}"),
        ("particles.beads", "{material: glass, insert: {kind: file, file: link/beads.csv}}"),
    ],
)
def test_input_files_in_the_output_directory_are_not_replaced(capsys, key, value):
    Path("out").mkdir()
    Path("out/timeseries.csv").touch()
    Path("out/beads.csv").write_text("x,y,z,diameter\n0,0,0.01,0.004\n")
    write(Path("out/bowl.stl"), *cube())
    Path("link").symlink_to("out")
    assert main(["run", "beads.yaml", "--out", "out", "--overwrite", "--set", f"{key}={value}"]) == 2
    assert re.search(rf"{key}\S* is .*, which is in the output directory out ", capsys.readouterr().err)
    assert len(list(Path("out").glob("[!.]*"))) == 3
