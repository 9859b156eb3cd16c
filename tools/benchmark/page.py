"""Writes README.md of this folder from measured results: tables, a figure, explanations, commands."""

import json
from pathlib import Path
from typing import Any

from benchmark import phases, tables

PAGE = Path(__file__).with_name("README.md")
FIGURE = PAGE.with_name("scaling.svg")
PHASE_COLUMNS = (
    "case", "law", "threads", "phase", "us", "MB", "GB/s", "Gop/s", "bytes alone", "arithmetic alone", "bound reached",
    "C++ / granflow",
)  # fmt: skip
TEXT = """# Performance of granflow

This page is written by `python tools/bench.py --page {name}`; the results are in [`{results}`]({results}).

{machine}

## Comparison with other codes

{table}

{notes}
{figure}
### How to read it

- All codes start from the same particle positions: settled beds in a box with five frictional walls, and a discharging
  conical hopper. Radius 2 mm with 10 % spread, Young's modulus 10 MPa, friction 0.5, restitution 0.9, float64, time
  step 10 us, no output.
- All codes compute Hertz contacts with damping and Mindlin friction with history. For `zhou` and `linear`, the column
  `granflow / code` is the rate of `hertz` over that of the model.
- The codes run in turn in several rounds, each in separate processes. The rate is the median over the rounds, with the
  slowest and the fastest in brackets. Ratios are computed within a round, so that a temporary slowdown of the machine
  affects both codes; the table shows their median and range.
- The table lists the neighbor-list skin of each code; the comment on `SKINS` in `codes.py` explains the choice, and
  `--skin CODE=MM,...` sets other values. Threads are OpenMP threads in YADE and MPI ranks in LAMMPS and LIGGGHTS.
- `C++ loops / step` is the fraction of the reachable speed on this processor: the time of the two loops of a step, as
  C++ (`loops.cpp`, `g++ -O3 -march=native`) computes them on the particles and neighbor lists of the run, over the time
  of a step of granflow. The C++ has the same layout, chunks and arithmetic, but no walls, no rebuilds, no exact sums and
  only one of the checks. It is measured after the run, without other codes; `g++` must be installed.
- `memory` is the peak of the process, or of all ranks together, including the program (Taichi's compiler takes a few
  hundred MB). `bytes/particle` is the memory that granflow allocates for particles and contacts. `start` is the time
  from the start of the process to the end of the first step, with kernels from Taichi's cache if available.
- `contacts/particle` counts each contact of two particles once. `mass flow` is the flow through the outlet during the
  measurement, early in the discharge; equal flows show that all codes do the same work.
- A measurement takes some seconds. LAMMPS and LIGGGHTS rebuild the neighbor list before the measured time of each run;
  for granflow, the measured time includes all rebuilds.

## Other processors

Medians of `granflow / code` with their ranges, f64, from the other files in `results/`.

{others}

## Time per phase

{phases}

## What limits a step

Measured on 2026-11-28 on an AMD EPYC (Zen 4, AVX-512) that others used too: ranges of pairs of runs one after the other.

- **Quadrants and Taichi** take the same time per step within the noise, since Quadrants inlines the batch of contacts
  (hopper, one thread, f64, `hertz` and `zhou`: 151 to 220 and 152 to 198 ns per particle; before, Quadrants took 274 to
  320 ns). On an Intel Xeon with AVX-512 (2026-11-30, idle, two rounds, one after the other), Quadrants takes 1.12 to
  1.21 times as long for 10 000 and 50 000 particles and the hopper, on one and two threads: it calls LLVM without the
  vectorization of straight-line code, so that the step of the hopper has 475 multiplications of one number and 130 of
  several, with Taichi 246 and 256. Commands therefore use Taichi there.
- **Integration** takes 8 to 13 ns per particle between 10 000 and 200 000 particles, 10 to 17 after the forces have
  displaced its data from the cache, of 100 to 150 ns for the step; the same loop in C++ takes 9 to 12. Without any check
  of limits it takes 5 to 8. Without quotients (stored 1/m and 1/I) the C++ gains 2 ns at 1000 particles, 0.3 to 0.7 at
  10 000 and 50 000 and nothing at 200 000: at most 2 % of a step, so that the quotients remain. With each component
  of all particles in an array of its own, C++ takes 3 ns in the cache, but 14 and 15 at 1000 and 200 000 particles.
- **Chunks**: a pair across two chunks is evaluated twice. With chunks of 512 particles that is 22 % of all pairs of a
  settled bed, with 1024 14 to 17 %, with 2048 8 to 13 %, with 4096 5 to 11 %. Chunks whose size follows from particles
  and threads, with the same bits, on a shared machine (2026-11-29, AMD EPYC, Zen 3; medians of alternating windows of 40 ms in two processes, in CPU time on one thread, wall-clock time on two).

  | case | threads | chunk before | chunk now | speed now / before | pairs of windows |
  |---|---|---|---|---|---|
  | bed 1000 | 1 | 512 | 1000 | 1.04 | 43 |
  | bed 10000 | 1 | 512 | 10 000 | 1.21 | 193 |
  | bed 50000 | 1 | 2048 | 16 384 | 1.03 | 22 |
  | hopper | 1 | 1024 | 16 384 | 1.15 | 57 |
  | bed 10000 | 2 | 512 | 1250 | 1.07 | 339 |

  All codes on one thread of that machine, in turn, in M particle-steps per CPU second (medians), and granflow over the
  other code before and now:

  | case | rounds | granflow before | granflow now | LAMMPS (2021) | LIGGGHTS 3.8 | / LAMMPS | / LIGGGHTS |
  |---|---|---|---|---|---|---|---|
  | bed 1000 | 3 | 7.5 | 7.4 | 5.6 | 3.7 | 1.31, 1.30 | 2.07, 1.95 |
  | bed 10000 | 3 | 5.0 | 6.1 | 4.3 | 3.1 | 1.17, 1.51 | 1.64, 2.00 |
  | bed 50000 | 2 | 5.0 | 5.4 | 3.5 | 2.9 | 1.42, 1.53 | 1.73, 1.84 |
  | bed 200000 | 2 | 4.5 | 4.9 | 3.2 | 2.2 | 1.38, 1.51 | 2.00, 2.20 |
  | hopper | 2 | 4.1 | 4.9 | 2.9 | 2.3 | 1.42, 1.72 | 1.81, 2.18 |

- **Processors newer than the compiler**: LLVM 15, the compiler in Taichi 1.7.4, does not know AMD's family 26 (Zen 5) and
  optimizes for x86 without AVX there: the optimized code of the hopper has vectors of two numbers only (1843 places, none of
  four), Quadrants with LLVM 22 has vectors of eight. Medians on an idle machine, M particle-steps/s: Taichi (three rounds)
  one thread 10.7, 10.2, 7.9, hopper 8.2, two threads 17.7, 12.5, 14.5, hopper 13.9; Quadrants (two rounds, in turn with
  the peers of the table above) one thread 17.0, 15.1, 11.3, hopper 10.3, two threads 27.6, 23.4, 17.8, hopper 17.9, for 1000,
  10000 and 50000 particles. `granflow run` says so at the end of a run of more than a minute with Taichi.
- **Start with Quadrants**: it transforms each kernel twice, the first time for dataclasses among the arguments, and reads
  each function with the tokenizer. Without both, CPU time of a start of the hopper on Zen 3 (two runs each, loaded machine):
  nothing compiled 11.3 and 13.5 s, Taichi 19.6 and 19.8 s; compiled before 6.0 and 6.9 s (14.1 s before the change), Taichi
  6.1 and 6.0 s. CPU time of steps (hopper, 0.25 to 0.35 s, one thread, four pairs in turn): 9.5 to 10.1 s, Taichi 8.9 to
  10.3 s. Commands therefore use Quadrants where it is installed, but on processors of Intel.
- **Order of the particles**: the order of cells in blocks of 8 x 8 x 8 puts as few pairs across chunks as the Hilbert curve
  and the Z-order curve within 1 to 3 points, for chunks of 512 to 4096. The curves would be another sort for no gain.
- **Chunks of a worker**: workers that begin each phase with chunks of their own instead of the next one of all, so that
  the particles are in their cache: -5 to +4 % (10 000 particles, two threads, chunks of 512 to 2048, 126 to 339 windows).
- **Quotients of a contact**: with products in place of the three effective values, which is wrong, a step takes 2 % less
  (one thread, 60 pairs of windows): one quotient for two of them is worth less than 1 %.
- **Roots of a contact**: without the root of the mean over the first step, and without that of the ratio of stiffnesses,
  which is wrong, a step takes 1 to 5 % less. Neither can be left out: the first step takes its mean at another overlap,
  and the ratio would need a further number in each history.
- **Launches**: a launch takes 35 to 70 us, for 1000 particles more than the integration. The times of phases above
  contain one; those of a run do not. Steps of a run are taken many per launch: with two particles a step takes 0.3 to 0.5 us.

## Repeat the measurement

```
python tools/bench.py --peers liggghts,lammps,yade
python tools/bench.py --phases --sizes 50000
python tools/bench.py --page
```

The other codes are the Debian packages `liggghts`, `lammps`, `yade` and `openmpi-bin`; missing ones are reported and
skipped. `--quick` takes about two minutes. Beds are read from `--beds DIR` (`bed*.data`, LAMMPS format); without them
granflow settles small beds and tiles larger ones from mirror images. `--hopper-data FILE` contains the particles of the
hopper.
"""


def write(folder: Path, name: str) -> Path:
    """Writes the page from the results `name`, or from the newest results."""
    peer_file = newest(folder, "peers", name)
    phase_file = newest(folder, "phases", "")
    if peer_file is None:
        raise SystemExit(
            f"There are no results {name or ''} in {folder}: run tools/bench.py without --page first."
        )
    result = json.loads(peer_file.read_text())
    PAGE.write_text(
        TEXT.format(
            name=peer_file.stem,
            results=f"results/{peer_file.name}",
            machine=machine_lines(result),
            table=tables.markdown(tables.COLUMNS, list(tables.rows(result))),
            notes="\n".join(f"- {note}" for note in result["notes"]) + "\n",
            others=other_results(folder, peer_file),
            figure=f"![Rate over size]({FIGURE.name})\n" if draw(result) else "",
            phases=phase_section(json.loads(phase_file.read_text()))
            if phase_file
            else "Not measured yet: `--phases`.",
        )
    )
    return PAGE


def other_results(folder: Path, shown: Path) -> str:
    """Table of the ratios of all other results in double precision, newest first, and their notes."""
    head = ("processor, kernels of granflow", "date", "code", "threads", "case", "granflow / code")
    body: list[tuple[str, list[str]]] = []
    notes: list[str] = []
    for path in folder.glob("*.json"):
        result = json.loads(path.read_text())
        if path == shown or result.get("kind") != "peers" or not is_double(result):
            continue
        machine = result["machine"]
        notes += result["notes"]
        for group in tables.groups(result):
            found = None if group.code == "granflow" else tables.ratio(result, group)
            if found is not None:
                version = next((point["version"] for point in group.points if "version" in point), "")
                day = machine["date"].split()[0]
                code = f"{group.code} {version}"
                ours = f"{machine['processor']}, {machine.get('kernels', 'taichi')}"
                row = [ours, day, code, str(group.threads), group.case, found.text()]
                body.append((machine["date"], row))
    rows = [row for _, row in sorted(body, key=lambda each: each[0], reverse=True)]
    return "\n".join([tables.markdown(head, rows), "", *(f"- {note}" for note in notes)])


def newest(folder: Path, kind: str, name: str) -> Path | None:
    """The newest results of a kind in double precision by date and time, or the results `name` in any
    precision."""
    found = []
    for path in folder.glob("*.json"):
        result = json.loads(path.read_text())
        chosen = name in (path.stem, path.name) if name else is_double(result)
        if result.get("kind") == kind and chosen:
            found.append((result["machine"]["date"], path))
    return max(found)[1] if found else None


def is_double(result: dict[str, Any]) -> bool:
    """Whether all measurements of granflow are in double precision."""
    return all(point.get("precision", "f64") == "f64" for point in result.get("points", ()))


def machine_lines(result: dict[str, Any]) -> str:
    """Machine and versions as two lines of text."""
    machine = result["machine"]
    versions = machine["versions"] | {
        each["code"]: each["version"] for each in result["points"] if "version" in each
    }
    memory = f", {machine['memory'] / 2**30:.0f} GiB" if machine["memory"] else ""
    cache = f", {machine['last_level_cache'] / 2**20:.0f} MiB of cache" if machine["last_level_cache"] else ""
    changed = " with local changes" if machine["changed"] else ""
    return (
        f"{machine['processor']} ({machine['instructions']}), {machine['cores']} cores{cache}{memory}, "
        f"{machine['system']}; "
        f"{machine['date']}, commit {machine['commit']}{changed}.\n"
        + ", ".join(f"{name} {number}" for name, number in versions.items())
        + f", Python {machine['python']}."
    )


def phase_section(result: dict[str, Any]) -> str:
    """Section on the phases: limits of the machine, table, kernels."""
    table = tables.markdown(PHASE_COLUMNS, phases.rows(result))
    kernels = "\n".join(line for point in result["points"] for line in phases.kernel_lines(point))
    return (
        "Limits of the machine, measured in the same run:\n\n"
        + "\n".join(f"- {line}" for line in phases.limit_lines(result))
        + (
            "\n\nLower bounds of a phase are the times for its bytes and for its arithmetic, counted in "
            "`counts.py`. Values of `rebuild` are per rebuild of the neighbor list, the others per "
            f"step.\n\n{table}\n\n```\n{kernels}\n```"
        )
    )


def draw(result: dict[str, Any]) -> bool:
    """Draws the rate over the particle count for each number of threads; False without matplotlib."""
    try:
        from matplotlib import rcParams
        from matplotlib.figure import Figure
    except ImportError:
        return False
    rcParams["svg.hashsalt"] = "granflow"
    beds = [group for group in tables.groups(result) if group.case.startswith("bed")]
    threads = sorted({group.threads for group in beds})
    if not threads:
        return False
    figure = Figure(figsize=(4.5 * len(threads), 3.6), layout="constrained")
    for axes, number in zip(
        figure.subplots(1, len(threads), sharey=True, squeeze=False)[0], threads, strict=True
    ):
        labels = sorted(
            {g.label for g in beds if g.threads == number}, key=lambda label: (label[0] != "g", label)
        )
        for index, label in enumerate(labels):
            line = [(g.count, g.spread("rate")) for g in beds if (g.threads, g.label) == (number, label)]
            middle = [rate.middle / 1e6 for _, rate in line if rate]
            style = {"marker": "o", "markersize": 4, "color": f"C{index}", "label": label}
            axes.plot([count for count, _ in line], middle, linewidth=2 if label[0] == "g" else 1, **style)
            spans = [(rate.low / 1e6, rate.high / 1e6) for _, rate in line if rate]
            axes.vlines(
                [count for count, _ in line], *zip(*spans, strict=True), color=f"C{index}", linewidth=1
            )
        axes.set(
            xscale="log", xlabel="particles", title=f"{number} thread" + "s" * (number > 1), ylim=(0, None)
        )
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("M particle-steps/s")
    figure.axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(FIGURE, metadata={"Date": None})
    return True
