"""Performance benchmark of granflow: comparison with other DEM codes, time per phase, cost of features.

    python tools/bench.py                                  granflow only
    python tools/bench.py --peers liggghts,lammps,yade     granflow and other codes on the same cases, in turn
    python tools/bench.py --phases                         time per phase and the limits of this machine
    python tools/bench.py --features SCENE                 time and memory of a step of a scene, with and without
                                                           each of its features; table in Markdown
    python tools/bench.py --roofline SCENE                 memory traffic of a particle-step, and the largest rate
                                                           that the data sheets of GPUs permit; nothing runs
    python tools/bench.py --ranks --peers liggghts,lammps  as the first, also granflow on MPI ranks
    python tools/bench.py --page                           write tools/benchmark/README.md, and the table of
                                                           docs/pages/guides/parallel.md, from the newest
                                                           results

Each measurement of beds runs in a separate process. Nothing is installed: for a missing code, the package is
reported.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

from benchmark import features, ours, page, phases, ranks_page, roofline, rounds, tables
from benchmark.cases import SIZES
from benchmark.codes import PEERS, missing
from benchmark.machine import machine

import granflow as gf
from granflow.engine.kernel_cache import CACHE_VARIABLE

RESULTS = Path(__file__).resolve().parent / "benchmark" / "results"
LAWS = ("hertz", "zhou", "linear")
QUICK = {"sizes": [1_000, 10_000, 50_000], "laws": ["hertz"], "threads": [2], "rounds": 1, "scale": 0.5}
CHILDREN: dict[str, Callable[..., Any]] = {
    "measure": ours.measure,
    "measure_on_ranks": ours.measure_on_ranks,
    "settle": ours.relax,
    "phases": phases.measure,
    "limits": phases.limits,
}


def main() -> None:
    """Runs the measurement that the command line selects, or writes the page."""
    if sys.argv[1:2] == ["--child"]:
        order = json.loads(sys.argv[2])
        answer = CHILDREN[order.pop("job")](**order)
        print()
        print(json.dumps(answer) if isinstance(answer, dict) else "")
        return
    options = arguments()
    if options.page is not None:
        print(f"Written: {page.write(RESULTS, options.page)}, {ranks_page.write(RESULTS)}")
        return
    if options.features is not None:
        measure_features(options)
        return
    if options.roofline is not None:
        print(roofline.text(gf.plan_for(gf.load_scene(options.roofline), on_gpu=True)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.work or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        (measure_phases if options.phases else measure_codes)(options, folder)


def measure_codes(options: argparse.Namespace, folder: Path) -> None:
    """Measures granflow and the available peers, in turn."""
    peers = available_peers(options)
    out = options.out or RESULTS / f"{default_name(options)}{'-ranks' if options.ranks else ''}.json"
    result = rounds.measure_all(options, rounds.gather_cases(options, folder), peers, folder, out)
    print(tables.text(result))
    print(f"Written: {out}")


def measure_phases(options: argparse.Namespace, folder: Path) -> None:
    """Measures the time of each phase of granflow."""
    out = options.out or RESULTS / f"{default_name(options)}-phases.json"
    result = phases.measure_all(options, rounds.gather_cases(options, folder), folder)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(result, indent=1) + "\n")
    print(phases.text(result))
    print(f"Written: {out}")


def measure_features(options: argparse.Namespace) -> None:
    """Measures the cost of each feature of a scene, with an empty kernel cache: all variants are compiled."""
    scene = gf.load_scene(options.features)
    with tempfile.TemporaryDirectory() as kernels:
        os.environ[CACHE_VARIABLE] = kernels  # read when Taichi starts
        found = features.feature_costs(scene, options.arch, options.threads[0], options.until, print)
        text = features.text(found, scene.title)
        print(f"\n{text}")
        if options.out is not None:
            options.out.write_text(text + "\n", encoding="utf-8")
        sys.stdout.flush()


def available_peers(options: argparse.Namespace) -> list[str]:
    """Peers that can run; reports missing ones, and stops if none of the requested peers is available."""
    messages = {name: missing(name, options.threads) for name in options.peers}
    for message in filter(None, messages.values()):
        print(message)
    if options.peers and all(messages.values()):
        raise SystemExit("None of the requested peers is installed. Remove --peers to measure granflow only.")
    return [name for name, message in messages.items() if message is None]


def default_name(options: argparse.Namespace) -> str:
    """File name made of the date, the processor and, unless it is f64, the precision."""
    words = machine()["processor"].lower().replace("(r)", "").replace("(tm)", "").split()
    precision = [] if options.precision == "f64" else [options.precision]
    return "-".join([date.today().isoformat(), *words[:4], *precision])


def peer_names(text: str) -> list[str]:
    """Comma-separated list of peers."""
    names = [name.strip().lower() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in PEERS:
            raise argparse.ArgumentTypeError(f"Unknown peer {name}. The peers are {', '.join(PEERS)}.")
    return names


def skins(text: str) -> dict[str, float]:
    """`CODE=MILLIMETERS,...` as lengths [m]."""
    try:
        pairs = [each.split("=") for each in text.split(",")]
        return {name.strip(): 1e-3 * float(value) for name, value in pairs}
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text} does not have the form granflow=0.2,lammps=0.5 (in mm)."
        ) from None


def arguments() -> argparse.Namespace:
    """Parsed command line; --quick changes the defaults."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--peers", type=peer_names, default=[], help="codes to compare with: any of liggghts,lammps,yade")
    add("--phases", action="store_true", help="measure the time of each phase of granflow")
    add("--features", metavar="SCENE", type=Path, help="measure the cost of each feature of a scene")
    add("--until", metavar="T", type=float, help="of --features: time of the measurement [s] (a third)")
    add("--arch", default="cpu", help="of --features: compute device or backend (cpu)")
    add("--roofline", metavar="SCENE", type=Path, help="print the largest rates of GPUs from data sheets")
    add(
        "--page",
        nargs="?",
        const="",
        metavar="NAME",
        help="write the page from the results NAME (newest in f64)",
    )
    add(
        "--quick",
        action="store_true",
        help="about two minutes: up to 50 000 particles, two threads, one round",
    )
    add("--sizes", type=int, nargs="*", help=f"particles in a bed ({' '.join(map(str, SIZES))})")
    add("--no-hopper", dest="hopper", action="store_false", help="skip the hopper")
    add("--laws", nargs="+", choices=LAWS, help="contact models of granflow (all); peers use Hertz-Mindlin")
    add("--threads", type=int, nargs="+", help="threads or MPI ranks (1 2; --features: all)")
    add("--ranks", action="store_true", help="also granflow on MPI ranks, one in place of each thread")
    add("--rounds", type=int, help="rounds (3)")
    add("--precision", choices=("f64", "f32", "mixed"), default="f64", help="precision of granflow (f64)")
    add(
        "--skin",
        type=skins,
        default={},
        metavar="CODE=MM,...",
        help="neighbor-list skins in mm; default: the fastest known",
    )
    add("--scale", type=float, help="factor on the number of steps (1)")
    add("--beds", type=Path, metavar="DIR", help="folder with settled beds bed*.data[.gz]")
    add("--hopper-data", type=Path, metavar="FILE", help="particles of the hopper as a LAMMPS data file")
    add("--work", type=Path, metavar="DIR", help="directory that keeps beds and inputs for later runs")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="file of the results (tools/benchmark/results/DATE-CPU.json, DATE-CPU-mixed.json); of "
        "--features, the table in Markdown",
    )
    options = parser.parse_args()
    defaults: dict[str, Any] = {
        "sizes": list(SIZES),
        "laws": list(LAWS),
        "threads": [1, 2],
        "rounds": 3,
        "scale": 1.0,
    }
    if options.features is not None:
        defaults["threads"] = [None]
    for key, value in (defaults | (QUICK if options.quick else {})).items():
        if getattr(options, key) is None:
            setattr(options, key, value)
    return options


if __name__ == "__main__":
    main()
