"""The table of what leaving out saves: for the terminal, as CSV, and as Markdown for a page."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from granflow.study.feature_cost.measure import STEPS, STEPS_BEFORE, FeatureCost
from granflow.study.figures import write_columns

HEADS = ("", "step ns", "time", "bytes", "compile s", "contacts")


def cost_rows(found: Sequence[FeatureCost]) -> list[tuple[str, ...]]:
    """One row a variant. Step, bytes and contacts are per particle; time is the ratio with its quartiles."""
    return [
        (
            each.name,
            f"{each.nanoseconds:.1f}",
            f"{each.ratio[1]:.2f} ({each.ratio[0]:.2f}-{each.ratio[2]:.2f})",
            f"{each.bytes_per_particle:.0f}",
            f"{each.compile_seconds:.1f}",
            f"{each.contacts_per_particle:.2f}",
        )
        for each in found
    ]


def remarks(found: Sequence[FeatureCost]) -> list[str]:
    """What a reader must know to read the table."""
    simulated_ms = 1e3 * (STEPS_BEFORE + STEPS) * found[0].plan.time_step
    law = found[0].plan.law
    law_remark = f"Without history elastic hertz stands for {law.name}. " if law.history_names else ""
    return [
        "Step, bytes and contacts are those of one particle; time is relative to the scene as it stands, the median "
        "and quartiles of rounds in which every row had its turn. Searching for neighbors is not in it.",
        f"Every timing begins with the same particles in the same places and lasts {simulated_ms:.2g} ms, since "
        f"what is left "
        "out changes what happens: contacts, at its end, says how far.",
        f"{law_remark}Rotation goes with friction and rolling friction.",
        "Radius and mass are kept for every particle in any scene: several radii cost nothing.",
    ]


def write_feature_costs(out: Path, found: Sequence[FeatureCost], title: str) -> None:
    """Write feature_cost.csv and feature_cost.md into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    write_columns(out / "feature_cost.csv", _columns(found))
    lines = [f"## {title}", "", _line(HEADS), _line(["---", *["---:"] * (len(HEADS) - 1)])]
    lines += [*(_line(row) for row in cost_rows(found)), "", *(f"- {each}" for each in remarks(found))]
    (out / "feature_cost.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _columns(found: Sequence[FeatureCost]) -> dict[str, np.ndarray]:
    columns = {"variant": np.array([each.name for each in found])}
    for column, end in enumerate(("low", "median", "high")):
        columns[f"ratio_{end}"] = np.array([each.ratio[column] for each in found])
    for name in ("nanoseconds", "bytes_per_particle", "compile_seconds", "contacts_per_particle"):
        columns[name] = np.array([getattr(each, name) for each in found])
    return columns
