"""The page beside this file, README.md, from measured results: tables, a figure, how to read and repeat them."""

import json
from pathlib import Path
from typing import Any

from benchmark import phases, tables

PAGE = Path(__file__).with_name("README.md")
FIGURE = PAGE.with_name("scaling.svg")
PHASE_COLUMNS = (
    "case", "law", "threads", "phase", "us", "MB", "GB/s", "Gop/s", "bytes alone", "arithmetic alone", "bound reached",
)  # fmt: skip
TEXT = """# How fast granflow is

This page is written by `python tools/bench.py --page`; the numbers are in [`{results}`]({results}).

{machine}

## Side by side

{table}

{notes}
{figure}
### How to read it

- The same spheres in the same places: settled beds in a box with five frictional walls, and a conical hopper that
  discharges. Radius 2 mm with 10 % spread, 10 MPa, friction 0.5, restitution 0.9, float64, steps of 10 us, no output.
- All codes compute Hertz contacts with damping and Mindlin friction with history. granflow's `zhou` and `linear`
  stand beside; the `granflow / code` column then says how much more they cost than `hertz`.
- The codes run in turn, round after round, each in processes of its own. The rate is the median over the rounds, in
  brackets the slowest and the fastest. Ratios are taken within a round, then their median and range: what slows the
  machine for a while slows both.
- Every code has a neighbor skin of its own, given in the table; how they were chosen stands at `SKINS` in `codes.py`,
  and `--skin CODE=MM,...` tries others. Threads are OpenMP threads in YADE and MPI ranks in LAMMPS and LIGGGHTS.
- `memory` is the peak of the whole process, or of all ranks together, with the program itself (Taichi's compiler takes
  a few hundred MB); `bytes/sphere` is all that granflow allocates for its spheres and contacts. `start` is from the
  start of the process to the end of the first step, with kernels from Taichi's cache if they are there.
- `contacts/sphere` counts each contact of two grains once. `mass flow` is what passes the outlet under the clock, early
  in the discharge: it says that all codes do the same work.
- A window is seconds long. LAMMPS and LIGGGHTS list neighbors anew before the clock of each run starts; granflow pays
  for its lists within.

## Where the time goes

{phases}

## Repeat it

```
python tools/bench.py --peers liggghts,lammps,yade
python tools/bench.py --phases --sizes 50000
python tools/bench.py --page
```

The peers are the Debian packages `liggghts`, `lammps`, `yade` and `openmpi-bin`; nothing is installed for you, and
those that are not there are named and left out. `--quick` takes about two minutes. Beds are read from `--beds DIR`
(`bed*.data`, LAMMPS format); without them granflow settles small ones and tiles them with mirror images. The hopper's
spheres come from `--hopper-data FILE`.
"""


def write(folder: Path, name: str) -> Path:
    """Write the page from the results of that name, or the newest."""
    compared, phased = newest(folder, "peers", name), newest(folder, "phases", "")
    if compared is None:
        raise SystemExit(f"There are no results {name or ''} in {folder}: measure first, with --peers or without.")
    result = json.loads(compared.read_text())
    PAGE.write_text(
        TEXT.format(
            results=f"results/{compared.name}",
            machine=machine_lines(result),
            table=tables.markdown(tables.COLUMNS, list(tables.rows(result))),
            notes="\n".join(f"- {note}" for note in result["notes"]) + "\n",
            figure=f"![Rate over size]({FIGURE.name})\n" if draw(result) else "",
            phases=phase_part(json.loads(phased.read_text())) if phased else "Not measured yet: `--phases`.",
        )
    )
    return PAGE


def newest(folder: Path, kind: str, name: str) -> Path | None:
    """The newest results of a kind, by the date they hold; by name if one is given."""
    found = []
    for path in folder.glob("*.json"):
        result = json.loads(path.read_text())
        if result.get("kind") == kind and name in ("", path.stem, path.name):
            found.append((result["machine"]["date"], path))
    return max(found)[1] if found else None


def machine_lines(result: dict[str, Any]) -> str:
    """Machine and versions in two sentences."""
    held = result["machine"]
    versions = held["versions"] | {each["code"]: each["version"] for each in result["points"] if "version" in each}
    memory = f", {held['memory'] / 2**30:.0f} GiB" if held["memory"] else ""
    cache = f", {held['last_level_cache'] / 2**20:.0f} MiB of cache" if held["last_level_cache"] else ""
    changed = " with changes" if held["changed"] else ""
    return (
        f"{held['processor']} ({held['instructions']}), {held['cores']} cores{cache}{memory}, {held['system']}; "
        f"{held['date']}, commit {held['commit']}{changed}.\n"
        + ", ".join(f"{name} {number}" for name, number in versions.items())
        + f", Python {held['python']}."
    )


def phase_part(result: dict[str, Any]) -> str:
    """Limits, table and kernels of the phases."""
    table = tables.markdown(PHASE_COLUMNS, phases.rows(result))
    kernels = "\n".join(line for point in result["points"] for line in phases.kernel_lines(point))
    return (
        "What the machine can do, measured in the same run:\n\n"
        + "\n".join(f"- {line}" for line in phases.limit_lines(result))
        + "\n\nEach phase takes at least the time for its bytes or for its arithmetic, counted in `counts.py`. "
        f"A search is one search, the others are per step.\n\n{table}\n\n```\n{kernels}\n```"
    )


def draw(result: dict[str, Any]) -> bool:
    """Rate over size for each number of threads; False without matplotlib."""
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
    for axes, number in zip(figure.subplots(1, len(threads), sharey=True, squeeze=False)[0], threads, strict=True):
        labels = sorted({g.label for g in beds if g.threads == number}, key=lambda label: (label[0] != "g", label))
        for place, label in enumerate(labels):
            line = [(g.count, g.spread("rate")) for g in beds if (g.threads, g.label) == (number, label)]
            middle = [rate.middle / 1e6 for _, rate in line if rate]
            style = {"marker": "o", "markersize": 4, "color": f"C{place}", "label": label}
            axes.plot([count for count, _ in line], middle, linewidth=2 if label[0] == "g" else 1, **style)
            spans = [(rate.low / 1e6, rate.high / 1e6) for _, rate in line if rate]
            axes.vlines([count for count, _ in line], *zip(*spans, strict=True), color=f"C{place}", linewidth=1)
        axes.set(xscale="log", xlabel="spheres", title=f"{number} thread" + "s" * (number > 1), ylim=(0, None))
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("M particle-steps/s")
    figure.axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(FIGURE, metadata={"Date": None})
    return True
