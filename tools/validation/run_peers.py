"""Runs LIGGGHTS and LAMMPS on the cases of the validation and stores their figures.

    python tools/validation/run_peers.py [CASE ...] [--out out/peers]

Writes figures, version and date of each case to tools/validation/peers/figures.json. Needs the
programs `liggghts` and `lmp` (Debian packages liggghts and lammps). With names of cases, such as "flat silo
with a slot", only those are run, and the figures of the other cases remain.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from validation.peers import compare, programs  # noqa: E402


def main() -> None:
    """Run both codes and store their figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "cases", nargs="*", metavar="CASE", help=f"one of {', '.join(compare.CASES)} (default: all)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/peers"), metavar="DIR", help="files of the runs"
    )
    options = parser.parse_args()
    if missing := set(programs.PROGRAMS) - set(programs.installed()):
        parser.error(f"{' and '.join(sorted(missing))} not installed")
    if unknown := set(options.cases) - set(compare.CASES):
        parser.error(f"no case {', '.join(sorted(unknown))}; there are {', '.join(compare.CASES)}")
    chosen = {
        name: case for name, case in compare.CASES.items() if name in options.cases or not options.cases
    }
    found = compare.run_peers(options.out, print, chosen)
    kept = compare.stored_figures()
    compare.write_figures(compare.FIGURES, {code: kept[code] | content for code, content in found.items()})


if __name__ == "__main__":
    main()
