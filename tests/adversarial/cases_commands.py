"""Invalid command lines for each verb, and values in wrong units or out of range."""

import json

from adversarial.beads import BEADS, beads
from adversarial.case import Case


def line(name: str, command: str, *patterns: str, text: str = "", **more) -> Case:
    """Case of one command line, in a directory with the scene of ten particles."""
    options = {"prepare": beads(), "code": 2} | more
    return Case(
        "command lines",
        f"line_{name}",
        text or f"`granflow {command}`",
        (command,),
        patterns=patterns,
        **options,
    )


def directory_without_run(sandbox) -> None:
    """Writes a scene, and a directory with other files."""
    sandbox.write("beads.yaml", BEADS)
    sandbox.write("out/notes.txt", "other")


def other_files_unchanged(sandbox, finished) -> None:
    """Files that granflow did not write are unchanged."""
    assert sandbox.path("out/notes.txt").read_text() == "other"


def nothing_written(sandbox, finished) -> None:
    """A rejected command writes no directory."""
    assert not sandbox.path("out").exists(), sorted(sandbox.path("out").rglob("*"))


def reaches_restitution(sandbox, finished) -> None:
    """The restitution of the collision equals that of the closed form."""
    numbers = json.loads(finished.out)
    assert abs(numbers["restitution"] / numbers["restitution_asked"] - 1.0) < 1e-3, numbers


INVALID = [
    line("none", "", "required: COMMAND", text="`granflow` without a verb"),
    line("verb", "bake beads.yaml", "invalid choice: 'bake'"),
    line("run_none", "run", "required: SCENE"),
    line("run_two", "run beads.yaml other.yaml", "unrecognized arguments: other.yaml"),
    line("run_threads", "run beads.yaml --threads 0", "whole number of at least 1"),
    line("run_threads_text", "run beads.yaml --threads many", "whole number of at least 1"),
    line("run_until_unit", "run beads.yaml --until 4mm", "--until: 4mm"),
    line("run_until_nan", "run beads.yaml --until nan", "finite"),
    line(
        "run_until_negative",
        "run beads.yaml --until=-1 --out out",
        "--until",
        verify=nothing_written,
        verified="nothing is written",
    ),
    line("run_until_zero", "run beads.yaml --until 0 --out out", code=(0, 2)),
    line("run_arch", "run beads.yaml --arch abacus", "invalid choice: 'abacus'"),
    line("run_precision", "run beads.yaml --precision f16", "invalid choice: 'f16'"),
    line("run_set", "run beads.yaml --set particles", "key.path=value"),
    line("run_set_unknown", "run beads.yaml --set particles.bead.count=3", "Did you mean beads", quick=True),
    line("run_set_list", "run beads.yaml --set domain.max.7=3", "domain.max"),
    line("run_out_file", "run beads.yaml --out beads.yaml", "beads.yaml", "directory"),
    line("run_out_below_file", "run beads.yaml --out beads.yaml/run", "beads.yaml", "directory"),
    line("run_out_null", "run beads.yaml --out /dev/null", "/dev/null"),
    line("run_out_proc", "run beads.yaml --out /proc/run", "/proc/run"),
    line(
        "run_out_long",
        f"run beads.yaml --out {'x' * 300}",
        "name too long",
        text="`granflow run beads.yaml --out` with a name of 300 characters",
    ),
    line(
        "run_out_notes",
        "run beads.yaml --out out --until 1ms",
        code=0,
        prepare=directory_without_run,
        verify=other_files_unchanged,
        verified="other files in the directory are kept",
        text="an output directory that holds other files",
    ),
    line("resume_none", "resume", "required: DIR"),
    line("resume_missing", "resume nowhere", "no such directory"),
    line(
        "resume_no_run",
        "resume out",
        "contains no run",
        prepare=directory_without_run,
        verify=other_files_unchanged,
        verified="the directory is unchanged",
    ),
    line("resume_file", "resume beads.yaml", "directory"),
    line("check_unit", "check beads.yaml --set run.duration=3kg", "kg is a unit of mass"),
    line(
        "check_unknown_unit",
        "check beads.yaml --set 'particles.beads.diameter=4 furlong'",
        "furlong is not a known unit",
    ),
    line("check_negative", "check beads.yaml --set particles.beads.diameter=-4mm", "above 0"),
    line("check_count", "check beads.yaml --set particles.beads.count=1e12", "count"),
    line("check_small_region", "check beads.yaml --set particles.beads.count=1000", "only"),
    line("explain_missing", "explain no.yaml", "no such file"),
    line("schema_extra", "schema beads.yaml", "is not a key of a scene"),
    line("collide_material", "collide --material butter --diameter 1mm --velocity 1", "butter"),
    line(
        "collide_law", "collide --law newton --material stainless_316 --diameter 1mm --velocity 1", "newton"
    ),
    line(
        "collide_unit", "collide --material stainless_316 --diameter 1kg --velocity 1", "kg is a unit of mass"
    ),
    line(
        "collide_negative", "collide --material stainless_316 --diameter=-1mm --velocity 1", "diameter|length"
    ),
    line("collide_zero", "collide --material stainless_316 --diameter 1mm --velocity 0", "velocity"),
    line(
        "collide_fast",
        "collide --material stainless_316 --diameter 1mm --velocity 1e30",
        "velocity",
        "radius",
    ),
    line(
        "collide_small",
        "collide --material stainless_316 --diameter 1e-20 --velocity 1 --json",
        code=0,
        verify=reaches_restitution,
        verified="the restitution is within 0.1 % of the closed form",
    ),
    line(
        "collide_restitution",
        "collide --material stainless_316 --diameter 1mm --velocity 1 --restitution 2",
        "restitution",
    ),
    line(
        "collide_steps",
        "collide --material stainless_316 --diameter 1mm --velocity 1 --steps-per-contact 0",
        "steps",
    ),
    line(
        "collide_steps_nan",
        "collide --material stainless_316 --diameter 1mm --velocity 1 --steps-per-contact nan",
        "steps",
    ),
    line("restitution_missing", "restitution no.yaml", "no such file"),
    line("fit_missing", "fit no.csv --fit-limit", "no.csv"),
    line("fit_both", "fit no.csv --fit-limit --limit-velocity 3", "not allowed with"),
    line("fit_directory", "fit . --fit-limit", "directory"),
    line("analyze_missing", "analyze nowhere", "not the directory of a run|no run|no such"),
    line("analyze_no_run", "analyze out", "scene_as_run.yaml|no run", prepare=directory_without_run),
    line("paper_out", "paper --out beads.yaml", "beads.yaml|granflow\\[plot\\]"),
    line("paper_extra", "paper beads.yaml", "unrecognized arguments"),
    line("compare_law", "compare beads.yaml --laws newton", "newton"),
    line("compare_none", "compare beads.yaml --laws ''", "laws"),
    line("stability_extra", "stability beads.yaml", "unrecognized arguments"),
    line("accuracy_target", "accuracy --target=-1", "target"),
    line("accuracy_target_text", "accuracy --target small", "target"),
    line("render_missing", "render nowhere", "nowhere"),
    line("render_no_run", "render out", "out", prepare=directory_without_run),
    line("render_size", "render out --size 0x0", "0x0"),
    line("render_range", "render out --range 2,1", "2,1"),
    line("report_missing", "report nowhere", "nowhere"),
    line("report_no_run", "report out", "out", prepare=directory_without_run, verify=other_files_unchanged),
    line("cache_extra", "cache --delete", "unrecognized arguments"),
]

CASES = INVALID
