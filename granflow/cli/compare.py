"""`granflow compare`: one scene under several normal laws, side by side."""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_machine, add_scene_verb, load, quantity, simulated_time
from granflow.cli.messages import say, show_table
from granflow.cli.scenes import prepare_output


def compare(options: argparse.Namespace) -> int:
    """`granflow compare`: run the scene under each law, then show the table and what it says of linear springs."""
    from granflow.study.compare import law_names
    from granflow.study.compare.variants import variant_keys

    laws = law_names(options.laws)
    scene = load(options)
    out = options.out or Path("out") / f"{scene.path.stem}_compare"
    for key in variant_keys(laws):
        prepare_output(out / key, scene, options.overwrite)
    from granflow.study.compare.report import PAGE, compare, size_note, stage_note, stop_notes
    from granflow.study.compare.summary import as_text, heads

    found = compare(
        scene, laws, out, options.arch, options.reference_velocity, options.until, options.full,
        lambda words: say(f"{words} ...", flush=True),
    )  # fmt: skip
    show_table(scene.title, heads(found.runs), as_text(found.rows))
    for words in (stage_note(found), size_note(found), *stop_notes(found)):
        say(words)
    for judged in found.assessments:
        say(f"{judged.part}: {judged.verdict}. {judged.why}")
    say(f"Open {out / PAGE} in a browser, and {out / 'side_by_side.py'} in ParaView (File > Load State).")
    return 0


def add_compare(verbs: Any) -> None:
    """`granflow compare` and its arguments."""
    parser = add_scene_verb(verbs, compare, "run a scene under several laws and show what differs, on one page")
    parser.add_argument(
        "--laws", default="zhou,linear,hertz", help="laws with commas; linear runs twice (zhou,linear,hertz)"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="where it goes (out/, the scene's name and _compare)")
    parser.add_argument(
        "--reference-velocity",
        metavar="V",
        type=quantity("velocity"),
        help="approach velocity of the one linear spring (a tenth of the fastest expected)",
    )
    parser.add_argument("--until", metavar="T", type=simulated_time, help="stop each run at this simulated time")
    parser.add_argument("--full", action="store_true", help="all particles, even if they are more than 4000")
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier comparison in the same directory")
    add_machine(parser)
