"""How fast granflow is: beside other codes, and phase by phase.

    python tools/bench.py                                  granflow alone
    python tools/bench.py --peers liggghts,lammps,yade     side by side on the same work, in turn
    python tools/bench.py --phases                         where the time goes, against this machine's limits
    python tools/bench.py --page                           tools/benchmark/README.md from the newest results

Every measurement is a process of its own. Nothing is installed: a peer that is missing is named with its package.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

from benchmark import ours, page, phases, rounds, tables
from benchmark.cases import SIZES
from benchmark.codes import PEERS, missing
from benchmark.machine import machine

RESULTS = Path(__file__).resolve().parent / "benchmark" / "results"
LAWS = ("hertz", "zhou", "linear")
QUICK = {"sizes": [1_000, 10_000, 50_000], "laws": ["hertz"], "threads": [2], "rounds": 1, "scale": 0.5}
CHILDREN: dict[str, Callable[..., Any]] = {
    "measure": ours.measure,
    "settle": ours.relax,
    "phases": phases.measure,
    "limits": phases.limits,
}


def main() -> None:
    """Do what the command line asks."""
    if sys.argv[1:2] == ["--child"]:
        order = json.loads(sys.argv[2])
        answer = CHILDREN[order.pop("job")](**order)
        print()
        print(json.dumps(answer if isinstance(answer, dict) else {}))
        return
    options = arguments()
    if options.page is not None:
        print(f"Written: {page.write(RESULTS, options.page)}")
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.work or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        (phase_by_phase if options.phases else side_by_side)(options, folder)


def side_by_side(options: argparse.Namespace, folder: Path) -> None:
    """granflow and the peers that are there, in turn."""
    peers = present(options)
    out = options.out or RESULTS / f"{name_of_today()}.json"
    result = rounds.measure_all(options, rounds.gather_cases(options, folder), peers, folder, out)
    print(tables.text(result))
    print(f"Written: {out}")


def phase_by_phase(options: argparse.Namespace, folder: Path) -> None:
    """Where granflow's time goes."""
    out = options.out or RESULTS / f"{name_of_today()}-phases.json"
    result = phases.measure_all(options, rounds.gather_cases(options, folder), folder)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(result, indent=1) + "\n")
    print(phases.text(result))
    print(f"Written: {out}")


def present(options: argparse.Namespace) -> list[str]:
    """Peers that can run; says what is missing, and stops if not one of those asked is there."""
    sentences = {name: missing(name, options.threads) for name in options.peers}
    for sentence in filter(None, sentences.values()):
        print(sentence)
    if options.peers and all(sentences.values()):
        raise SystemExit("None of the peers asked for is there. Without --peers, granflow is measured alone.")
    return [name for name, sentence in sentences.items() if sentence is None]


def name_of_today() -> str:
    """Date and processor, as a file name."""
    words = machine()["processor"].lower().replace("(r)", "").replace("(tm)", "").split()
    return "-".join([date.today().isoformat(), *words[:4]])


def peer_names(text: str) -> list[str]:
    """A list of peers with commas between."""
    names = [name.strip().lower() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in PEERS:
            raise argparse.ArgumentTypeError(f"{name} is not known here; known are {', '.join(PEERS)}.")
    return names


def skins(text: str) -> dict[str, float]:
    """`CODE=MILLIMETERS,...` as lengths in meters."""
    try:
        pairs = [each.split("=") for each in text.split(",")]
        return {name.strip(): 1e-3 * float(value) for name, value in pairs}
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not of the form granflow=0.2,lammps=0.5 (millimeters).") from None


def arguments() -> argparse.Namespace:
    """The command line; --quick sets what is not given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--peers", type=peer_names, default=[], help="liggghts,lammps,yade or some of them")
    add("--phases", action="store_true", help="where granflow's time goes")
    add("--page", nargs="?", const="", metavar="NAME", help="write the page from the results NAME (the newest)")
    add("--quick", action="store_true", help="about two minutes: up to 50 000 spheres, two threads, one round")
    add("--sizes", type=int, nargs="*", help=f"spheres in a bed ({' '.join(map(str, SIZES))})")
    add("--no-hopper", dest="hopper", action="store_false", help="leave out the hopper")
    add("--laws", nargs="+", choices=LAWS, help="granflow's laws (all); peers run Hertz-Mindlin")
    add("--threads", type=int, nargs="+", help="threads, or ranks (1 2)")
    add("--rounds", type=int, help="rounds (3)")
    add("--precision", choices=("f64", "f32", "mixed"), default="f64", help="granflow's precision (f64)")
    add("--skin", type=skins, default={}, metavar="CODE=MM,...", help="neighbor skins in place of the fastest known")
    add("--scale", type=float, help="factor on the number of steps (1)")
    add("--beds", type=Path, metavar="DIR", help="folder with settled beds bed*.data[.gz]")
    add("--hopper-data", type=Path, metavar="FILE", help="the hopper's spheres as a LAMMPS data file")
    add("--work", type=Path, metavar="DIR", help="keep beds and inputs there for the next run")
    add("--out", type=Path, metavar="FILE", help="where the results go (tools/benchmark/results/DATE-CPU.json)")
    options = parser.parse_args()
    usual = {"sizes": list(SIZES), "laws": list(LAWS), "threads": [1, 2], "rounds": 3, "scale": 1.0}
    for key, value in (usual | (QUICK if options.quick else {})).items():
        if getattr(options, key) is None:
            setattr(options, key, value)
    return options


if __name__ == "__main__":
    main()
