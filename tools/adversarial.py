"""Run the adversarial cases and write docs/pages/reference/invalid_inputs.md.

python tools/adversarial.py                 runs all cases and writes the page
python tools/adversarial.py NAME ...        runs the cases whose names contain NAME; keeps the other lines of
the page
"""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

# The package tests/adversarial has the name of this file, so that the folder of this file must not be on the
# path.
sys.path[0] = str(Path(__file__).resolve().parent.parent / "tests")


def main() -> int:
    """Runs the cases, prints one line for each and writes the page; returns 1 if a case fails."""
    from adversarial.page import CASES, PAGE, page_of, page_text

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="parts of case names; default: all cases")
    parser.add_argument("--jobs", type=int, default=1, help="number of cases that run simultaneously (1)")
    options = parser.parse_args()
    chosen = [case for case in CASES if not options.names or any(name in case.name for name in options.names)]
    outcomes = []
    with ThreadPoolExecutor(options.jobs) as pool:
        for outcome in pool.map(run_and_print, chosen):
            outcomes.append(outcome)
            PAGE.write_text(page_of({outcome.case.name: outcome}, page_text()), encoding="utf-8")
    failed = [outcome.case.name for outcome in outcomes if outcome.faults]
    print(f"{len(outcomes)} cases, {len(failed)} fail{': ' if failed else ''}{', '.join(failed)}")
    return 1 if failed else 0


def run_and_print(case: Any) -> Any:
    """Runs a case, prints its outcome and returns it."""
    from adversarial.case import outcome_of

    outcome = outcome_of(case)
    status = "FAIL" if outcome.faults else "skip" if outcome.skipped else "ok"
    lines = [
        f"{status:4} {case.name}: {outcome.skipped}{outcome.result}",
        *(f"     {fault}" for fault in outcome.faults),
    ]
    print("\n".join(lines), flush=True)
    return outcome


if __name__ == "__main__":
    sys.exit(main())
