"""Resumed runs with changed keys, missing or damaged files; runs that replace others or start from others."""

import json
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from adversarial.case import Case
from adversarial.runs import SAME, as_undisturbed, case, rain, reference, stopped
from adversarial.sandbox import Done, Sandbox, Skip


def resumed(command: str = "resume out", change=None):
    """A run killed half-way, a change of its files, then a command."""

    def act(sandbox: Sandbox) -> Done:
        out = stopped(sandbox)
        if change is not None:
            change(out)
        before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file() and path.suffix == ".vtu"}
        done = sandbox.run(command)
        if done.code == 2:
            after = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file() and path.suffix == ".vtu"}
            assert after == before, "the refused command changes the frames of the run"
        return done

    return act


def all_checkpoints(content):
    """Every checkpoint is replaced by `content(path)`."""

    def change(out: Path) -> None:
        for path in out.glob("checkpoint_*.npz"):
            path.write_bytes(content(path))

    return change


def newest(content):
    """The newest checkpoint is replaced by `content(path)`."""

    def change(out: Path) -> None:
        path = max(out.glob("checkpoint_*.npz"))
        path.write_bytes(content(path))

    return change


def rewritten(**header):
    """An intact checkpoint, checksum included, whose header says something else."""

    def content(path: Path) -> bytes:
        import hashlib

        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "a.npz"
            with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
                new.comment = b"0" * 64
                for name in old.namelist():
                    data = old.read(name)
                    if name == "header.json":
                        data = json.dumps(json.loads(data) | header).encode()
                    new.writestr(zipfile.ZipInfo(name), data)
            raw = target.read_bytes()[:-64]
        return raw + hashlib.sha256(raw).hexdigest().encode()

    return content


def as_directory(out: Path) -> None:
    """The newest checkpoint cannot be read (a link to a file whose reading fails with an I/O error)."""
    for path in out.glob("checkpoint_*.npz"):
        path.unlink()
        path.symlink_to("/proc/self/mem")


def removed(pattern: str):
    def change(out: Path) -> None:
        for path in out.glob(pattern):
            path.unlink()

    return change


def replaced(name: str, content: bytes):
    return lambda out: (out / name).write_bytes(content)


def other_python(sandbox: Sandbox) -> Done:
    """Resumed with another Python version."""
    here = sys.version_info[:2]
    for minor in (10, 11, 12, 13):
        found = shutil.which(f"python3.{minor}")
        if found and (3, minor) != here:
            probe = subprocess.run([found, "-c", "import granflow, taichi"], capture_output=True, cwd=sandbox.home)
            if not probe.returncode:
                stopped(sandbox)
                return sandbox.finish(sandbox.start_program([found, "-m", "granflow", "resume", "out"]), "resume out")
    raise Skip("no other Python version with granflow is installed")


def forced(*arguments: str, prepare=rain):
    """A finished run, then `run --overwrite` with arguments that are refused: the old run must stay."""

    def act(sandbox: Sandbox) -> Done:
        shutil.copytree(reference(), sandbox.path("out"))
        done = sandbox.run(" ".join(["run beads.yaml --out out --overwrite", *arguments]))
        as_undisturbed(sandbox)
        return done

    return act


def resumptions() -> list[Case]:
    """Resumed runs with changed keys, missing or damaged files; and runs that replace others."""
    group = "resumed and replaced runs"

    def refused(name, text, command, *says, change=None, **more):
        return case(
            group,
            name,
            text,
            resumed(command, change),
            2,
            says,
            killed=True,
            verified="the frames of the run stay",
            **more,
        )

    def goes_on(name, text, command="resume out", *says, change=None):
        return case(group, name, text, resumed(command, change), 0, says, verify=as_undisturbed, verified=SAME)

    format_99 = all_checkpoints(rewritten(format=99))
    return [
        refused(
            "resume_density",
            "another density",
            "resume out --set materials.glass.density=2600",
            "materials.glass.density",
        ),
        refused("resume_count", "more particles", "resume out --set particles.beads.count=50", "count"),
        refused("resume_gravity", "another gravity", "resume out --set 'gravity=[0, 0, -1]'", "gravity"),
        refused(
            "resume_step",
            "another time step, although told to accept changes",
            "resume out --allow-changes --set run.time_step=1e-6",
            "time_step",
        ),
        refused("resume_precision", "another precision", "resume out --precision f32", "precision"),
        refused(
            "resume_precision_anyway",
            "another precision, although told to accept changes",
            "resume out --precision f32 --allow-changes",
            "precision|time_step|f64",
        ),
        refused("resume_arch", "an accelerator that is absent", "resume out --arch cuda", "cuda"),
        refused("resume_unknown", "an unknown key", "resume out --set output.intervall=1", "Did you mean interval"),
        refused("resume_format", "checkpoints of another format version", "resume out", "format", change=format_99),
        refused(
            "resume_io",
            "checkpoints that cannot be read (I/O error)",
            "resume out",
            "Input/output error",
            change=as_directory,
        ),
        refused(
            "resume_rows",
            "a time series without its rows",
            "resume out",
            "lacks rows",
            change=replaced("timeseries.csv", b""),
        ),
        refused("resume_rows_gone", "no time series", "resume out", "lacks rows", change=removed("timeseries.csv")),
        refused(
            "resume_scene_bad",
            "a scene_as_run.yaml that is not YAML",
            "resume out",
            "scene_as_run.yaml",
            change=replaced("scene_as_run.yaml", b"["),
        ),
        refused(
            "resume_no_checkpoints",
            "no checkpoint, but frames of a run",
            "resume out",
            "checkpoint",
            change=removed("checkpoint_*.npz"),
        ),
        refused(
            "resume_all_damaged",
            "all checkpoints are damaged",
            "resume out",
            "damaged",
            change=all_checkpoints(lambda path: b"nonsense"),
        ),
        goes_on(
            "resume_newest_damaged",
            "a bit of the newest checkpoint is flipped",
            "resume out",
            "damaged",
            change=newest(lambda path: path.read_bytes()[:999] + b"?" + path.read_bytes()[1000:]),
        ),
        goes_on(
            "resume_newest_empty",
            "the newest checkpoint is empty",
            "resume out",
            "damaged",
            change=newest(lambda path: b""),
        ),
        goes_on("resume_scene_gone", "no scene_as_run.yaml", change=removed("scene_as_run.yaml")),
        goes_on(
            "resume_frames_gone",
            "a frame and a PVD file are missing beyond the checkpoint",
            change=removed("particles_0009.vtu"),
        ),
        goes_on(
            "resume_scraps",
            "temporary files and a frame of the future are left over",
            change=lambda out: (
                (out / ".a.vtu.99.part").write_bytes(b"x"),
                (out / "particles_0999.vtu").write_bytes(b"x"),
            ),
        ),
        case(group, "resume_python", "another Python version", other_python, 0, verify=as_undisturbed, verified=SAME),
        case(
            group,
            "force_arch",
            "`run --overwrite` on an accelerator that is absent",
            forced("--arch cuda"),
            2,
            ("cuda",),
            verified="the earlier run is intact",
        ),
        case(
            group,
            "force_step",
            "`run --overwrite` with a time step that is too large",
            forced("--set run.time_step=1s"),
            2,
            ("above the stable",),
            verified="the earlier run is intact",
        ),
        case(
            group,
            "force_room",
            "`run --overwrite` with more particles than fit",
            forced(
                "--set 'particles.beads.insert={kind: lattice, region: {box: {min: [0, 0, 0], max: [5mm, 5mm, 5mm]}}}'"
            ),
            2,
            ("only",),
            verified="the earlier run is intact",
        ),
        case(
            group,
            "force_start",
            "`run --overwrite` with `start_from` in the same directory",
            forced("--set start_from=out"),
            2,
            ("start_from",),
            verified="the earlier run is intact",
        ),
        case(
            group,
            "no_force",
            "`run` into the directory of an earlier run",
            lambda s: (shutil.copytree(reference(), s.path("out")), s.run("run beads.yaml --out out"))[1],
            2,
            ("contains an earlier run",),
            verify=as_undisturbed,
            verified="the earlier run is intact",
        ),
        case(
            group,
            "start_nowhere",
            "`start_from` names a directory without a run",
            lambda s: s.run("check beads.yaml --set start_from=nowhere"),
            2,
            ("start_from",),
        ),
        case(
            group,
            "start_damaged",
            "`start_from` names a run whose checkpoints are damaged",
            lambda s: (
                shutil.copytree(reference(), s.path("out")),
                all_checkpoints(lambda path: b"x")(s.path("out")),
                s.run("run beads.yaml --out new --set start_from=out"),
            )[-1],
            2,
            ("start_from", "damaged"),
        ),
    ]


CASES = resumptions()
