"""The normal laws by name. A new law is one new file and one line here."""

from collections.abc import Callable

from granflow.laws import hertz, linear, zhou
from granflow.laws.law import NormalLaw

NORMAL_LAWS: dict[str, Callable[..., NormalLaw]] = {
    "zhou": zhou.build,
    "hertz": hertz.build,
    "linear": linear.build,
}
