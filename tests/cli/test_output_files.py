"""Output files of commands: types, inputs that must not be replaced, and links."""

import os

import pytest
from plan.scenes import scene_of

import granflow as gf
from granflow.cli.main import main


@pytest.fixture(scope="module")
def run(tmp_path_factory, taichi_f64):
    """Directory of a short run of one ball, whose position is in a table with an unusual name."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "table.html").write_text("x,y,z,diameter\n0.01,0.01,0.01,0.004\n")
    ball = "{material: glass, insert: {kind: file, file: table.html}}"
    scene = scene_of(folder, f"particles={{ball: {ball}}}", "run.duration=0.1 ms", "output.interval=0.1 ms")
    with gf.Simulation(scene, threads=2, out=folder / "run") as simulation:
        simulation.run()
    return folder / "run"


@pytest.mark.parametrize(
    ("command", "name", "message"),
    [
        ("report", "scene_as_run.yaml", "is not of a supported type; the name must end in .html"),
        ("render", "run.log", "is not of a supported type; the name must end in .png"),
        (
            "plot --y particle_count",
            "timeseries.csv",
            "is not of a supported type; the name must end in .png",
        ),
        ("report --no-pictures", "table.html", "is particles.ball.insert.file of the run"),
        ("report", ".", "is a directory; give a file"),
    ],
)
def test_files_of_a_run_are_not_replaced(run, capsys, command, name, message):
    before = {path: path.read_bytes() for path in run.iterdir()}
    verb, *options = command.split()
    assert main([verb, str(run), "--out", str(run / name), *options]) == 2
    assert f"--out {run / name} {message}" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in run.iterdir()} == before


@pytest.mark.parametrize(
    ("package", "ending", "link"), [("matplotlib", "png", os.symlink), ("plotly", "html", os.link)]
)
def test_a_plot_replaces_a_link(tmp_path, package, ending, link):
    """The file to which an existing link leads, such as the time series, stays as it is."""
    pytest.importorskip(package)
    series = tmp_path / "timeseries.csv"
    out = tmp_path / f"curve.{ending}"
    series.write_text("time [s],mass [kg]\n0,1\n1,2\n")
    link(series, out)
    assert main(["plot", str(series), "--y", "mass", "--out", str(out)]) == 0
    assert series.read_text() == "time [s],mass [kg]\n0,1\n1,2\n"
    assert not out.is_symlink() and out.stat().st_size > 1000
    assert sorted(tmp_path.iterdir()) == sorted([series, out])


def test_a_resumed_run_replaces_links(run, tmp_path):
    """It extends copies of the log and of the table; the files outside, or a backup of hard links, stay."""
    for name in ("backup", "outside"):
        (tmp_path / name).mkdir()
    for path in run.iterdir():
        os.link(path, tmp_path / "backup" / path.name)
    out = tmp_path / "out"
    os.rename(run, out)
    for name in ("run.log", "particles.pvd"):
        os.rename(out / name, tmp_path / "outside" / name)
        (out / name).symlink_to(tmp_path / "outside" / name)
    before = {path: path.read_bytes() for path in (tmp_path / "backup").iterdir()}
    with gf.Simulation(gf.read_run(out).scene, threads=2, out=out, resume=out) as simulation:
        simulation.run(duration=1e-4)
    assert {path: path.read_bytes() for path in before} == before
    assert "resumed from" in (out / "run.log").read_text()
    for name in ("run.log", "particles.pvd", "timeseries.csv"):
        assert (out / name).read_bytes().startswith(before[tmp_path / "backup" / name][:20])
        assert (out / name).stat().st_size > len(before[tmp_path / "backup" / name])
