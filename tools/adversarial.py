"""Run the adversarial cases and write docs/adversarial.md.

python tools/adversarial.py                 all cases, then the page
python tools/adversarial.py NAME ...        cases whose name contains one of these words; other lines stay
"""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

sys.path[0] = str(Path(__file__).resolve().parent.parent / "tests")  # this folder has a file of that name


def main() -> int:
    """Run, print one line per case, write the page; 1 where a case fails."""
    from adversarial.page import CASES, PAGE, page_of, page_text

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="parts of names of cases")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time (1)")
    options = parser.parse_args()
    chosen = [case for case in CASES if not options.names or any(name in case.name for name in options.names)]
    with ThreadPoolExecutor(options.jobs) as pool:
        outcomes = list(pool.map(shown, chosen))
    PAGE.write_text(page_of({outcome.case.name: outcome for outcome in outcomes}, page_text()), encoding="utf-8")
    failed = [outcome.case.name for outcome in outcomes if outcome.faults]
    print(f"{len(outcomes)} cases, {len(failed)} fail{': ' if failed else ''}{', '.join(failed)}")
    return 1 if failed else 0


def shown(case: Any) -> Any:
    """The outcome of a case, printed."""
    from adversarial.case import outcome_of

    outcome = outcome_of(case)
    verdict = "FAIL" if outcome.faults else "skip" if outcome.skipped else "ok"
    lines = [
        f"{verdict:4} {case.name}: {outcome.skipped}{outcome.result}",
        *(f"     {fault}" for fault in outcome.faults),
    ]
    print("\n".join(lines), flush=True)
    return outcome


if __name__ == "__main__":
    sys.exit(main())
