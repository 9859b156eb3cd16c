"""`granflow compare`: one scene with several normal contact models, side by side.

All runs have the same seed and initial state; each contact model has its automatic time step.
"""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_machine, add_out, add_scene_verb, load_runnable, quantity, simulated_time
from granflow.cli.messages import exit_code_of, print_error, say, say_progress, show_table
from granflow.cli.scenes import prepare_output


def compare(options: argparse.Namespace) -> int:
    """`granflow compare`: run the scene with each contact model; print the table and assess linear springs.

    One subdirectory of the output directory per run, one page for all. Runs of the same comparison that have ended are
    not repeated, unless --overwrite is given. Raises GranflowError if the directory contains other runs, unless
    --overwrite is given. Returns 130 or 143 after a stop signal; the same command then continues the comparison.
    """
    from granflow.studies.compare.variants import law_names

    laws = law_names(options.laws)
    scene = load_runnable(options)
    out = options.out or Path("out") / f"{scene.path.stem}_compare"
    from granflow.studies.compare.report import PAGE, compare, notes_on, stage_note
    from granflow.studies.compare.summary import as_text, heads

    def prepare(directory: Path) -> None:
        prepare_output(directory, scene, options.overwrite)

    try:
        found = compare(
            scene, laws, out, options.arch, options.reference_velocity, options.until, options.full,
            say_progress, prepare, options.overwrite,
        )  # fmt: skip
    except KeyboardInterrupt as stop:
        remedy = "repeat the command to continue"
        return print_error(f"stopped; the runs that have ended are kept in {out}, {remedy}.", exit_code_of(stop))
    show_table(scene.title, heads(found.runs, is_short=True), as_text(found.rows))
    for note in (stage_note(found), *notes_on(found)):
        say(note)
    for assessment in found.assessments:
        say(f"{assessment.part}: {assessment.conclusion}. {assessment.why}")
    say(f"Open {out / PAGE} in a browser, and {out / 'side_by_side.py'} in ParaView (File > Load State).")
    return 0


LAWS = (
    "contact models, separated by commas (default: zhou,linear,hertz); linear is run twice: with a spring stiffness "
    "computed from the impact velocity of each contact, and from --reference-velocity"
)
REFERENCE_VELOCITY = (
    "impact velocity for which constant parameters are computed, such as the spring stiffness of the second linear run "
    "(default: a tenth of the largest expected impact velocity)"
)
"""Help texts of --laws and --reference-velocity."""


def add_compare(verbs: Any) -> None:
    """Add `granflow compare` and its arguments."""
    summary = "run the same scene with several contact models and compare the results on one page"
    parser = add_scene_verb(verbs, compare, summary)
    add = parser.add_argument
    add("--laws", default="zhou,linear,hertz", help=LAWS)
    add_out(parser, "out/SCENE_compare")
    add("--reference-velocity", metavar="V", type=quantity("velocity"), help=REFERENCE_VELOCITY)
    add("--until", metavar="T", type=simulated_time, help="stop each run at this simulated time")
    add("--full", action="store_true", help="use all particles (default: at most 4000)")
    add(
        "--overwrite",
        action="store_true",
        help="replace other runs in the same directory, and repeat those that have ended",
    )
    add_machine(parser)
