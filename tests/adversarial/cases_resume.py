"""Resumed runs with changed keys, missing or damaged files; runs that replace other runs or start from
them."""

import json
import shutil
import tempfile
import zipfile
from pathlib import Path

from adversarial.case import Case
from adversarial.runs import IDENTICAL, assert_undisturbed, case, killed_run, reference, write_scene
from adversarial.sandbox import FinishedProcess, Sandbox


def resumed(command: str = "resume out", change=None):
    """Kills a run after half of its frames, changes its files, then runs a command."""

    def act(sandbox: Sandbox) -> FinishedProcess:
        out = killed_run(sandbox)
        if change is not None:
            change(out)
        before = {
            path.name: path.read_bytes() for path in out.iterdir() if path.is_file() and path.suffix == ".vtu"
        }
        finished = sandbox.run(command)
        if finished.code == 2:
            after = {
                path.name: path.read_bytes()
                for path in out.iterdir()
                if path.is_file() and path.suffix == ".vtu"
            }
            assert after == before, "the rejected command changes the frames of the run"
        return finished

    return act


def all_checkpoints(content):
    """Replaces each checkpoint by `content(path)`."""

    def change(out: Path) -> None:
        for path in out.glob("checkpoint_*.npz"):
            path.write_bytes(content(path))

    return change


def newest(content):
    """Replaces the newest checkpoint by `content(path)`."""

    def change(out: Path) -> None:
        path = max(out.glob("checkpoint_*.npz"))
        path.write_bytes(content(path))

    return change


def rewritten(**header):
    """Content of a valid checkpoint, including its checksum, with changed entries of the header."""

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


def removed(pattern: str):
    def change(out: Path) -> None:
        for path in out.glob(pattern):
            path.unlink()

    return change


def replaced(name: str, content: bytes):
    return lambda out: (out / name).write_bytes(content)


def overwrite(*arguments: str, prepare=write_scene):
    """Runs `run --overwrite` with rejected arguments on a finished run, which must remain unchanged."""

    def act(sandbox: Sandbox) -> FinishedProcess:
        shutil.copytree(reference(), sandbox.path("out"))
        finished = sandbox.run(" ".join(["run beads.yaml --out out --overwrite", *arguments]))
        assert_undisturbed(sandbox)
        return finished

    return act


def resumptions() -> list[Case]:
    """Resumed runs with changed keys, missing or damaged files; runs that replace other runs."""
    group = "resumed and replaced runs"

    def rejected(name, text, command, *patterns, change=None, **more):
        return case(
            group,
            name,
            text,
            resumed(command, change),
            2,
            patterns,
            killed=True,
            verified="the frames of the run are unchanged",
            **more,
        )

    def accepted(name, text, command="resume out", *patterns, change=None):
        return case(
            group,
            name,
            text,
            resumed(command, change),
            0,
            patterns,
            verify=assert_undisturbed,
            verified=IDENTICAL,
        )

    format_99 = all_checkpoints(rewritten(format=99))
    return [
        rejected(
            "resume_density",
            "another density",
            "resume out --set materials.glass.density=2600",
            "materials.glass.density",
        ),
        rejected("resume_count", "more particles", "resume out --set particles.beads.count=50", "count"),
        rejected(
            "resume_step",
            "another time step with --allow-changes",
            "resume out --allow-changes --set run.time_step=1e-6",
            "time_step",
        ),
        rejected("resume_precision", "another precision", "resume out --precision f32", "precision"),
        case(
            group,
            "resume_precision_allow_changes",
            "another precision with --allow-changes",
            resumed("resume out --precision f32 --allow-changes", None),
            0,
            killed=True,
        ),
        rejected(
            "resume_format", "checkpoints of another format version", "resume out", "format", change=format_99
        ),
        rejected(
            "resume_no_time_series",
            "no time series",
            "resume out",
            "lacks rows",
            change=removed("timeseries.csv"),
        ),
        rejected(
            "resume_scene_bad",
            "a scene_as_run.yaml that is not YAML",
            "resume out",
            "scene_as_run.yaml",
            change=replaced("scene_as_run.yaml", b"["),
        ),
        rejected(
            "resume_no_checkpoints",
            "no checkpoint, but frames of a run",
            "resume out",
            "checkpoint",
            change=removed("checkpoint_*.npz"),
        ),
        rejected(
            "resume_all_damaged",
            "all checkpoints are damaged",
            "resume out",
            "damaged",
            change=all_checkpoints(lambda path: b"nonsense"),
        ),
        accepted(
            "resume_newest_damaged",
            "a bit of the newest checkpoint is flipped",
            "resume out",
            "damaged",
            change=newest(lambda path: path.read_bytes()[:999] + b"?" + path.read_bytes()[1000:]),
        ),
        accepted(
            "resume_newest_empty",
            "the newest checkpoint is empty",
            "resume out",
            "damaged",
            change=newest(lambda path: b""),
        ),
        accepted("resume_no_scene", "no scene_as_run.yaml", change=removed("scene_as_run.yaml")),
        accepted(
            "resume_frames_missing",
            "a frame and a PVD file are missing beyond the checkpoint",
            change=removed("particles_0009.vtu"),
        ),
        accepted(
            "resume_temporary_files",
            "temporary files and a later frame exist",
            change=lambda out: (
                (out / ".a.vtu.99.part").write_bytes(b"x"),
                (out / "particles_0999.vtu").write_bytes(b"x"),
            ),
        ),
        case(
            group,
            "overwrite_step",
            "`run --overwrite` with a time step that is too large",
            overwrite("--set run.time_step=1s"),
            2,
            ("above the stability limit",),
            verified="the earlier run is intact",
        ),
        case(
            group,
            "overwrite_start",
            "`run --overwrite` with `start_from` in the same directory",
            overwrite("--set start_from=out"),
            2,
            ("start_from",),
            verified="the earlier run is intact",
        ),
        case(
            group,
            "no_overwrite",
            "`run` into the directory of an earlier run",
            lambda s: (shutil.copytree(reference(), s.path("out")), s.run("run beads.yaml --out out"))[1],
            2,
            ("contains an earlier run",),
            verify=assert_undisturbed,
            verified="the earlier run is intact",
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
