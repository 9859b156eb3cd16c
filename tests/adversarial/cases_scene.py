"""Invalid scene files, and invalid values in each block."""

from pathlib import Path

from ruamel.yaml import YAML

from adversarial.beads import BEADS, changed, scene
from adversarial.case import Case

MESSAGES = Path(__file__).parents[1] / "messages"
GOOD = (MESSAGES / "good.yaml").read_text(encoding="utf-8")
SENTENCES = {
    each["name"]: each
    for each in YAML(typ="safe", pure=True).load((MESSAGES / "cases.yaml").read_text(encoding="utf-8"))
}

BLOCKS = {
    "scene": ("unknown top key", "missing gravity", "duplicate key", "tab", "recursion", "tag"),
    "materials": ("density 1e308", "density nan", "young unit", "preset unknown"),
    "pairs": ("restitution 1.2", "friction negative", "pair missing", "pair twice"),
    "contact": ("law typo", "linear without stiffness", "rolling typo"),
    "walls": (
        "zero normal",
        "sides skewed",
        "hole too big",
        "vanishes early",
        "vibration of three",
        "free wall without mass",
    ),
    "particles": ("count zero", "position outside", "sizes turned", "rate zero", "region outside"),
    "domain": ("domain turned", "domain periodic twice", "domain shear along one axis"),
    "stages": ("stage without end", "stage twice", "duration and stages"),
    "run, numerics": ("time step", "precision", "numerics"),
    "output": ("interval bad", "fields with too many cells", "meter normal"),
    "expect": ("expect nothing", "expect unknown meter"),
}
"""Cases of tests/messages/cases.yaml by block; that file contains further cases with their own tests."""


def shown(change: dict) -> str:
    """Description of an input: the new text, or the removed one."""
    old, new = next(iter(change.items()))
    return f"`{' '.join(new.split())}`" if new.strip() else f"`{' '.join(old.split())}` is missing"


def block_cases() -> list[Case]:
    """One case for each name in BLOCKS: `granflow check` rejects it with the position and the key."""
    return [
        Case(
            f"invalid scenes: {block}",
            f"block_{name.replace(' ', '_')}",
            shown(SENTENCES[name]["change"]),
            ("check beads.yaml",),
            patterns=(r"beads.yaml:\d+:\d+: ", r"\d+ problems? found"),
            prepare=scene(changed(GOOD, *SENTENCES[name]["change"].items())),
            quick=name in ("density 1e308", "zero normal"),
        )
        for block, names in BLOCKS.items()
        for name in names
    ]


def aliases() -> str:
    """Nine levels of ten aliases each: 1e9 values if all aliases are expanded."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 10)]
    return "\n".join(lines) + "\n"


def file_case(name: str, text: str, content: str | bytes, *patterns: str, **more) -> Case:
    """Case of `granflow check` of a scene file with this content."""
    return Case(
        "scene files", name, text, ("check beads.yaml",), patterns=patterns, prepare=scene(content), **more
    )


def no_scene(sandbox) -> None:
    sandbox.path("beads.yaml").unlink(missing_ok=True)


def loop(sandbox) -> None:
    sandbox.path("beads.yaml").symlink_to("again.yaml")
    sandbox.path("again.yaml").symlink_to("beads.yaml")


def pipe(sandbox) -> None:
    import os

    os.mkfifo(sandbox.path("beads.yaml"))


def device(name: str):
    return lambda sandbox: sandbox.path("beads.yaml").symlink_to(name)


def file_cases() -> list[Case]:
    """Files that are empty, binary, endless, too large or missing."""
    return [
        file_case("empty", "an empty file", "", "empty", quick=True),
        file_case("binary", "random bytes with NUL", bytes(range(256)) * 40, "binary|UTF-8"),
        file_case("utf16", "UTF-16", BEADS.encode("utf-16"), "UTF-16"),
        file_case(
            "not_utf8",
            "Latin-1 text with an accent",
            BEADS.replace("Ten", "T\u00e9n").encode("latin-1"),
            "UTF-8",
        ),
        file_case("json_list", "a list instead of a mapping", "[1, 2, 3]\n", "mapping"),
        file_case(
            "crlf_bom",
            "a valid scene with CR LF line ends and a byte order mark",
            b"\xef\xbb\xbf" + BEADS.replace("\n", "\r\n").encode(),
            "no problems",
            code=0,
        ),
        file_case("deep", "100 000 nested brackets", "title: " + "[" * 100_000, "deep|nested|bracket|closed"),
        file_case("aliases", "aliases that expand to 1e9 values", aliases(), "alias|large|not known|values"),
        file_case(
            "large",
            "a file of 50 MB",
            BEADS + "# comment\n" * 5_000_000,
            "large|MB",
            megabytes=1000,
            seconds=200,
        ),
        file_case(
            "long_line",
            "a title of 1e6 characters",
            BEADS.replace("Ten beads fall", "x" * 1_000_000),
            "no problems|title",
            code=(0, 2),
        ),
        file_case(
            "control_title",
            "ESC, NUL escapes and a right-to-left override in the title",
            BEADS.replace("Ten beads fall", '"\\e[31mred\\e]0;x\\a \\u202Eabc"'),
            "no problems|title",
            code=(0, 2),
        ),
        Case(
            "scene files",
            "control_run",
            "ESC and NUL escapes in the title, in a run: the terminal shows no control characters",
            ("run beads.yaml --out out",),
            0,
            patterns=(),
            verify=None,
            prepare=scene(BEADS.replace("Ten beads fall", '"\\e[31mred\\u202Eabc"')),
            verified="escaped",
        ),
        file_case(
            "control_key",
            "ESC in a key",
            BEADS.replace("seed", "seed") + '"s\\e[31mx": 3\n',
            "not a known key",
        ),
        Case(
            "scene files",
            "missing",
            "no such file",
            ("check beads.yaml",),
            patterns=("no such file",),
            prepare=no_scene,
            quick=True,
        ),
        Case("scene files", "directory", "a directory", ("check .",), patterns=("directory",)),
        Case(
            "scene files",
            "symlink_loop",
            "a loop of symbolic links",
            ("check beads.yaml",),
            patterns=("symbolic links|loop|cannot be read",),
            prepare=loop,
        ),
        Case(
            "scene files",
            "pipe",
            "a named pipe without a writer",
            ("check beads.yaml",),
            patterns=("beads.yaml", "file"),
            prepare=pipe,
            seconds=300,
        ),
        Case(
            "scene files",
            "zero_device",
            "/dev/zero, which never ends",
            ("check beads.yaml",),
            patterns=("beads.yaml",),
            prepare=device("/dev/zero"),
            seconds=300,
            megabytes=1000,
        ),
        Case(
            "scene files",
            "io_error",
            "a file whose reading fails (/proc/self/mem)",
            ("check beads.yaml",),
            patterns=("Input/output error",),
            prepare=device("/proc/self/mem"),
        ),
        Case(
            "scene files",
            "name_newline",
            "a newline in the name of the file: the message stays on one line",
            ("check 'be\nads.yaml'",),
            patterns=("no such file",),
            verify=one_line,
        ),
        Case(
            "scene files",
            "run_newline",
            "newlines, quotes and spaces in the paths of scene and output directory",
            ("run 'be\nad \"s.yaml' --out 'o\nu t'", "resume 'o\nu t'", "report 'o\nu t' --no-pictures"),
            0,
            prepare=lambda sandbox: sandbox.write('be\nad "s.yaml', BEADS),
        ),
        Case(
            "scene files",
            "unicode_path",
            "a path with Chinese characters in the C locale",
            ("run \u7403.yaml --out \u51fa",),
            0,
            prepare=lambda sandbox: sandbox.write("\u7403.yaml", BEADS),
            act=lambda sandbox: sandbox.run(
                "run \u7403.yaml --out \u51fa", env={"LC_ALL": "C", "PYTHONUTF8": None, "LANG": None}.items()
            ),
        ),
    ]


def one_line(sandbox, finished) -> None:
    """The path in the message is escaped, so that the message is one line."""
    lines = [line for line in finished.err.splitlines() if line and "problem" not in line.split()[1:2]]
    assert len(lines) == 1, finished.err


CASES = [*file_cases(), *block_cases()]
