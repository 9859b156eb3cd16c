"""Table of feature costs: for the terminal, as CSV and as Markdown."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from granflow.io.atomic_files import write_text
from granflow.studies.feature_cost.measure import STEPS, STEPS_BEFORE, FeatureCost
from granflow.studies.tables import attribute_columns, write_columns

HEADS = ("", "step ns", "time", "bytes", "compile s", "contacts")
"""Column headings of `cost_rows`."""


def cost_rows(found: Sequence[FeatureCost]) -> list[tuple[str, ...]]:
    """One row per variant. Step, bytes and contacts are per particle; time is the ratio with its quartiles."""
    rows: list[tuple[str, ...]] = []
    for each in found:
        low, median, high = each.ratio
        rows.append((
            each.name, f"{each.nanoseconds:.1f}", f"{median:.2f} ({low:.2f}-{high:.2f})",
            f"{each.bytes_per_particle:.0f}", f"{each.compile_seconds:.1f}", f"{each.contacts_per_particle:.2f}",
        ))  # fmt: skip
    return rows


def remarks(found: Sequence[FeatureCost]) -> list[str]:
    """Remarks for the interpretation of the table."""
    simulated_ms = 1e3 * (STEPS_BEFORE + STEPS) * found[0].plan.time_step
    law = found[0].plan.law
    law_remark = f"Without history, elastic hertz replaces {law.name}. " if law.history_names else ""
    return [
        "Step, bytes and contacts are per particle; time is relative to the baseline, as median and quartiles over "
        "rounds that time every row once. Neighbor-list rebuilds are not included.",
        f"Every timing starts from the same particle positions and covers {simulated_ms:.2g} ms of simulated time. "
        "A feature also changes the motion; the contacts at the end of the timing show to which extent.",
        f"{law_remark}Without rotation, friction and rolling friction are off, too.",
        "Radius and mass are stored for every particle of any scene: several radii have no additional cost.",
    ]


def write_feature_costs(out: Path, found: Sequence[FeatureCost], title: str) -> None:
    """Write feature_cost.csv and feature_cost.md into `out`, which is created if necessary; `title`: of the scene."""
    out.mkdir(parents=True, exist_ok=True)
    write_columns(out / "feature_cost.csv", _columns(found))
    lines = [f"## {title}", "", _line(HEADS), _line(["---", *["---:"] * (len(HEADS) - 1)])]
    lines += [*(_line(row) for row in cost_rows(found)), "", *(f"- {each}" for each in remarks(found))]
    write_text(out / "feature_cost.md", "\n".join(lines) + "\n")


def _line(cells: Sequence[str]) -> str:
    """One line of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def _columns(found: Sequence[FeatureCost]) -> dict[str, np.ndarray]:
    """Columns of feature_cost.csv: one row per variant."""
    ratios = np.array([each.ratio for each in found])
    return {
        "variant": np.array([each.name for each in found]),
        **dict(zip(("ratio_low", "ratio_median", "ratio_high"), ratios.T, strict=True)),
        **attribute_columns(found, ("nanoseconds", "bytes_per_particle", "compile_seconds", "contacts_per_particle")),
    }
