"""`granflow beverloo`: fits Beverloo's law of discharge to runs or tables.

Each run or row gives the mass flow rate [kg/s] through one orifice [m].
"""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_verb, quantity
from granflow.cli.messages import say, show_table


def beverloo(options: argparse.Namespace) -> int:
    """`granflow beverloo`: fit C and k of Beverloo's law; from four orifices also with a free exponent.

        W = C rho sqrt(g) d^2.5 (D/d - k)^n

    W: mass flow rate [kg/s], rho: bulk density [kg/m3], D: orifice, d: particle diameter [m]; n = 5/2 or free. (W. A.
    Beverloo et al., Chem. Eng. Sci. 15 (1961) 260.)
    """
    from granflow.studies.beverloo import beverloo_rows, fit_beverloo, read_discharges

    data = read_discharges(options.paths)
    given = (data, options.diameter, options.bulk_density, options.gravity)
    fits, heads = [fit_beverloo(*given)], ["exponent 5/2"]
    if len(set(data.orifice)) > len(("C", "k", "exponent")):
        fits.append(fit_beverloo(*given, exponent=None))
        heads.append("exponent free")
    say("W = C rho sqrt(g) d^2.5 (D/d - k)^n")
    show_table(f"{len(data.orifice)} flows", ("", *heads), beverloo_rows(fits))
    return 0


def add_beverloo(verbs: Any) -> None:
    """Add `granflow beverloo` and its arguments."""
    summary = "fit Beverloo's law to the flow rates of several runs, or of a table, with standard errors"
    parser = add_verb(verbs, beverloo, summary)
    add = parser.add_argument
    sources = "runs whose flow meter has the radius of the orifice, or tables with the columns orifice and mass_flow"
    add("paths", metavar="OUT|FILE.csv", type=Path, nargs="+", help=sources)
    add("--diameter", required=True, type=quantity("length"), help="particle diameter, such as 5mm")
    density = "bulk density of the bed, such as '1500 kg/m3'"
    add("--bulk-density", required=True, type=quantity("density"), help=density)
    acceleration = "gravitational acceleration (default: 9.81 m/s2)"
    add("--gravity", type=quantity("acceleration"), default=9.81, help=acceleration)
