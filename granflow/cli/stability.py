"""`granflow stability`: stiff and extreme cases, each with an assessment.

A case is accurate, stable with a reported error, refused with a message, or a defect.
"""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_out, add_verb
from granflow.cli.messages import say, show_table


def stability(options: argparse.Namespace) -> int:
    """`granflow stability`: run all cases; return 1 if any of them is a defect.

    Writes a page, `stability.csv` and a heat map to the output directory.
    """
    from granflow.studies.stability.report import HEADS, PAGE, defects, headline, summary_rows
    from granflow.studies.stability.report import stability as study

    out = options.out or Path("out/stability")
    outcomes, missing = study(
        out, options.full, lambda each: say(f"{each.row}, {each.column}: {each.assessment}", flush=True)
    )
    show_table("Stiff and extreme cases", HEADS, summary_rows(outcomes))
    defects_found = defects(outcomes)
    for line in filter(None, (headline(outcomes), *defects_found, missing)):
        say(line)
    say(f"Open {out / PAGE} in a browser; each case is a row of stability.csv in the same directory.")
    return 1 if defects_found else 0


def add_stability(verbs: Any) -> None:
    """Add `granflow stability` and its arguments."""
    summary = "run stiff and extreme cases, assess each, and measure the stability limit of the time step"
    parser = add_verb(verbs, stability, summary)
    add_out(parser, "out/stability")
    parser.add_argument(
        "--full", action="store_true",
        help="run all Young's moduli, particle radii and radius ratios (default: about half of them)",
    )  # fmt: skip
