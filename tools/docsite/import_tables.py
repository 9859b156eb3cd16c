"""Tables of the guide on imported scripts, from the tables of the importer."""

from collections.abc import Iterable, Mapping

from docsite.markdown import code, table
from granflow.importing.convert import all_commands, all_fixes
from granflow.importing.deck import Translation
from granflow.importing.materials import MODELS, PROPERTIES
from granflow.importing.schedule import COMPUTES

MARK = "<!-- import tables -->"
"""Where the tables stand in the guide."""


def tables() -> str:
    """All tables in Markdown."""
    properties = [(code(name), code(each.use), each.refused) for name, each in PROPERTIES.items()]
    models = [(code(script), code(scene), note) for script, scene, note in MODELS]
    computes = [(code(name), text) for name, text in COMPUTES.items()]
    parts = [
        ("Commands", table(("command", "scene", "remark"), rows(all_commands()))),
        ("Fixes", table(("`fix ID group ...`", "scene", "remark"), rows(all_fixes()))),
        ("Contact models", table(("script", "scene", "remark"), models)),
        ("Properties", table(("`property/global`", "scene", "remark"), properties)),
        ("Computes", table(("`compute ID group ...`", "result"), computes)),
    ]
    return "\n".join(f"### {title}\n\n{text}" for title, text in parts)


def rows(translations: Mapping[str, Translation]) -> Iterable[tuple[str, str, str]]:
    """Rows of a table; those with a counterpart first, those that are not possible last."""
    order = ("not needed", "not possible")

    def place(name: str) -> tuple[int, str]:
        counterpart = translations[name].counterpart
        return (order.index(counterpart) + 1 if counterpart in order else 0, name)

    for name in sorted(translations, key=place):
        each = translations[name]
        yield (
            code(name),
            each.counterpart if each.counterpart in order else code(each.counterpart),
            each.note,
        )
