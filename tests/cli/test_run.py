"""`granflow run` from end to end: ten particles fall on a floor."""

import json
import re
import shutil
import signal

import meshio
import pytest
from plan.scenes import TEXT, line_of

from granflow import Simulation
from granflow.cli.main import main

pytestmark = pytest.mark.usefixtures("taichi_f64")
SCENE = TEXT.replace("Ten beads fall", r'"Ten beads fall\e[31m\u202E"').replace("delete}", "error}")
SCENE += "expect:\n  - {quantity: particle_count, equals: 10, tolerance: 0}\n"
OUT = "out/b\neads 球"


def frames(directory, kind="particles"):
    return sorted(path.name for path in directory.glob(f"{kind}_*.vtu"))


def last_heights(directory):
    return meshio.read(directory / frames(directory)[-1]).points[:, 2]


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs the scene in an empty directory; returns exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "beads.yaml").write_text(SCENE)

    def call(out, *options, scene="beads.yaml"):
        code = main(["run", scene, "--threads", "2", "--out", str(out), *options])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def changes(*overrides):
    """Arguments --set for each override."""
    return [argument for override in overrides for argument in ("--set", override)]


def test_run_prints_a_summary_and_writes_all_files(tmp_path, run):
    """The title has control characters, which the terminal does not receive."""
    code, printed, errors = run(OUT)
    assert code == 0
    assert printed.startswith("beads.yaml: no problems found.\n") and "\x1b" not in printed + errors
    for fragment in ("Ten beads fall", "step count", "wall clock", "particle count", "particles.pvd"):
        assert fragment in printed
    assert "particle_count is 10, as expected equal to 10." in printed
    assert all(line.startswith("run: ") and "particle-steps/s" in line for line in errors.splitlines())
    out = tmp_path / OUT
    assert len(frames(out)) == len(frames(out, "walls")) == 6
    names = {path.name for path in out.iterdir() if path.suffix not in (".vtu", ".npz")}
    files = "particles.pvd walls.pvd timeseries.csv result.json scene_as_run.yaml run.log run.jsonl .lock"
    assert names == set(files.split()) and len(list(out.glob("checkpoint_*.npz"))) == 1
    assert 0.0015 < last_heights(out).min() < 0.003, "the particles rest on the floor or bounce slightly"
    log = (out / "run.log").read_text()
    for fragment in ("cpu with f64", "stability limit", "stage run begins at 0 s", "done at"):
        assert fragment in log

    shutil.copy(out / "scene_as_run.yaml", tmp_path / "again.yaml")
    assert run("again", scene="again.yaml")[0] == 0
    first, second = (json.loads((each / "result.json").read_text()) for each in (out, tmp_path / "again"))
    assert first["totals"] == second["totals"] and first["totals"]["particle_count"] == 10


def test_earlier_run_is_kept_without_overwrite_and_until_ends_the_run(tmp_path, run):
    out = tmp_path / "kept"
    assert run(out)[0] == 0
    (out / "notes.txt").write_text("other")
    assert run(out, "--until", "20 ms")[0] == 2
    assert len(frames(out)) == 6
    code, printed, _ = run(out, "--until", "20 ms", "--overwrite")
    assert code == 0
    assert "Expectations are not evaluated: --until ended the run at 0.02" in printed
    assert "as expected" not in printed
    assert len(frames(out)) == 3 and (out / "notes.txt").exists()


def test_unsatisfied_expectations_and_all_warnings_are_reported(tmp_path, run):
    """A coarse time step, an overlap limit that 1 m/s exceeds, and particles that are due after the end."""
    rain = "{kind: rain, rate: 10, start: 1 s, region: {box: {min: [0, 0, 1 cm], max: [2 cm, 2 cm, 2 cm]}}}"
    late = f"{{material: glass, count: 5, diameter: 4 mm, insert: {rain}}}"
    overrides = (
        "run.duration=2 ms", "run.time_step=5e-5", "numerics.max_overlap=0.05", f"particles.late={late}",
        "expect.0.equals=11",
    )  # fmt: skip
    code, printed, errors = run("warned", *changes(*overrides))
    assert code == 1
    assert "NOT AS EXPECTED: particle_count is 10, but should be equal to 11." in printed
    warnings = [line.partition("warning: ")[2] for line in errors.splitlines() if "warning: " in line]
    for words in ("an impact at 1 m/s", "no particle is inserted", "the restitution at 1 m/s"):
        assert sum(words in line for line in warnings) == 1, errors
    log = (tmp_path / "warned" / "run.log").read_text(encoding="utf-8")
    stored = json.loads((tmp_path / "warned" / "result.json").read_text(encoding="utf-8"))["warnings"]
    assert set(stored) == set(warnings) and len(warnings) == len(set(warnings))
    assert all(f"WARNING granflow: {line}" in log for line in warnings)


def test_ctrl_c_ends_the_run_with_a_checkpoint(tmp_path, run, monkeypatch):
    def interrupted(simulation, *arguments, **options):
        signal.raise_signal(signal.SIGINT)
        return complete(simulation, *arguments, **options)

    complete = Simulation.run
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # not as in a background process
    try:
        with monkeypatch.context() as patched:
            patched.setattr(Simulation, "run", interrupted)
            code, _, errors = run("stopped")
    finally:
        signal.signal(signal.SIGINT, before)
    assert code == 130
    assert "granflow: stopped at 0 s; granflow resume stopped continues." in errors
    assert main(["resume", "stopped", "--threads", "2"]) == 0
    assert len(frames(tmp_path / "stopped")) == 6


def test_aborted_run_writes_its_last_state(tmp_path, run):
    code, _, errors = run("aborted", *changes("numerics.max_overlap=1e-4"))
    assert code == 3
    message = errors.splitlines()[-1]
    assert message.startswith("granflow: Stopped: particle ")
    assert "times the smaller radius, more than numerics.max_overlap 0.0001" in message
    out = tmp_path / "aborted"
    assert not (out / "result.json").exists()
    abort_time = float(message.split(" at ")[1].split()[0])
    frame_times = re.findall(r'timestep="([^"]+)"', (out / "particles.pvd").read_text())
    assert float(frame_times[-1]) == pytest.approx(abort_time, rel=5e-4), "the message rounds to four digits"
    assert last_heights(out).min() < 0.002, "the frame shows the overlap"
    assert "ended by RunError: Stopped: particle" in (out / "run.log").read_text()

    code, _, errors = run("left", *changes("walls.floor.point=[0, 0, -5 cm]", "run.duration=1 s"))
    assert code == 3
    assert "is outside the domain" in errors and f"(beads.yaml:{line_of('on_exit')})" in errors
    assert frames(tmp_path / "left")
