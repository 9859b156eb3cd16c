"""Compares runs of granflow with runs of LIGGGHTS and LAMMPS, present or stored in `figures.json`."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.io.machine import allowed_cores
from validation.case import ValidationCase
from validation.peers import programs
from validation.peers.bed import COLUMN, HOPPER
from validation.peers.case import PeerCase, our_frames
from validation.peers.drum import DRUMS
from validation.peers.impact import IMPACT
from validation.peers.orifice import ORIFICE
from validation.peers.shaken import SHAKEN
from validation.peers.silo import SILO

CASES: Mapping[str, PeerCase] = {
    each.name: each for each in (COLUMN, HOPPER, SILO, ORIFICE, IMPACT, SHAKEN, *DRUMS)
}
"""Cases by name."""
FIGURES = Path(__file__).with_name("figures.json")
"""Stored figures of LIGGGHTS and LAMMPS."""
MODEL_ERROR = 0.02
"""Difference between the codes where they end a contact differently: with or without tension."""
CONFIDENCE = math.erf(3.0 / math.sqrt(2.0))
"""Probability of an interval of three standard deviations, 0.9973."""
Stored = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""For each code and case the version, the date of the runs, and the samples by figure."""


def stored_figures() -> dict[str, Any]:
    """Content of figures.json."""
    return dict(json.loads(FIGURES.read_text(encoding="utf-8")))


def run_peers(
    folder: Path, report: Callable[[str], None] = lambda text: None, cases: Mapping[str, PeerCase] = CASES
) -> dict[str, Any]:
    """Run the cases with each installed code, one run per core at a time; files of the runs are in `folder`.

    Returns what figures.json contains, for the installed codes, and writes it to `folder`. `report` is called
    with each code and case that starts.
    Raises GranflowError if no code is installed, or if a run fails.
    """
    codes = programs.installed()
    if not codes:
        names = " and ".join(f"{code} ({program})" for code, program in programs.PROGRAMS.items())
        raise GranflowError(
            f"--peers runs {names}, and neither is installed. Without --peers, stored figures are shown."
        )
    found = {}
    for code in codes:
        origin = {"version": programs.version(code, folder / code.lower()), "date": date.today().isoformat()}
        found[code] = {
            name: {**origin, "figures": _runs(code, each, folder, report)}
            for name, each in cases.items()
            if programs.simulates(code, each)
        }
    write_figures(folder / "figures.json", found)
    return found


def write_figures(path: Path, figures: Stored) -> None:
    """Write figures of the peers as JSON."""
    path.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def _runs(code: str, case: PeerCase, folder: Path, report: Callable[[str], None]) -> dict[str, list[float]]:
    """Samples of all runs of a case with one code."""
    report(f"{code}, {case.name}")
    where = folder / code.lower() / case.name.replace(" ", "_")
    with ThreadPoolExecutor(allowed_cores()) as pool:
        runs = list(
            pool.map(
                lambda repeat: programs.run(code, case, repeat, where / str(repeat)), range(case.repeats)
            )
        )
    return joined(runs)


def joined(runs: Sequence[Mapping[str, Sequence[float]]]) -> dict[str, list[float]]:
    """Samples of several runs by figure."""
    return {name: [value for run in runs for value in run[name]] for name in runs[0]}


def peer_cases(name: str, peers: Stored | None = None, repeats: int | None = None) -> list[ValidationCase]:
    """Figures of LIGGGHTS and LAMMPS, and those of repeated runs of granflow from the same initial states.

    peers:    figures of runs of the other codes; stored ones are taken for codes that are missing in it
    repeats:  number of runs of granflow; None for that of the case
    """
    case = CASES[name]
    ours = joined([case.samples(our_frames(case, repeat)) for repeat in range(repeats or case.repeats)])
    return compared(case, ours, stored_figures() | dict(peers or {}))


def compared(case: PeerCase, ours: Mapping[str, Sequence[float]], stored: Stored) -> list[ValidationCase]:
    """Cases of each peer from the samples of granflow and of the peers."""
    found = []
    for name, samples in ours.items():
        for peer, content in stored.items():
            if case.name not in content:
                continue
            run = content[case.name]
            theirs = run["figures"][name]
            reference = float(np.mean(theirs))
            scatter, reason = allowed_difference(samples, theirs)
            label, _, unit = name.partition(" [")
            found.append(
                ValidationCase(
                    f"LIGGGHTS and LAMMPS, {case.name}",
                    f"{peer}: {label}",
                    reference,
                    f"{run['version']}, run on {run['date']} from the same positions and velocities",
                    float(np.mean(samples)),
                    unit.rstrip("]") or "1",
                    (0.0 if case.equal_law else MODEL_ERROR) + scatter / abs(reference),
                    reason
                    if case.equal_law
                    else f"{100 * MODEL_ERROR:g} % between implementations, and {reason}",
                    remark=case.remark,
                )
            )
    return found


def allowed_difference(ours: Sequence[float], theirs: Sequence[float]) -> tuple[float, str]:
    """Largest difference of two means that scatter explains, and its derivation.

        t s sqrt(1/n + 1/m)

    with the pooled standard deviation s of n and m samples and Student's t for their n + m - 2 degrees of
    freedom.
    """
    from scipy.stats import t

    n = len(ours)
    m = len(theirs)
    squares = sum(float(np.sum((np.asarray(each) - np.mean(each)) ** 2)) for each in (ours, theirs))
    spread = math.sqrt(squares / (n + m - 2)) * math.sqrt(1.0 / n + 1.0 / m)
    factor = float(t.ppf(0.5 + 0.5 * CONFIDENCE, n + m - 2))
    return factor * spread, (
        f"{factor:.3g} standard deviations of the difference between the means of {n} and {m} runs or "
        f"intervals (Student's t for {100 * CONFIDENCE:.2f} %)"
    )
