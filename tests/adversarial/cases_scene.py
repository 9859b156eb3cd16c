"""Scene files in other encodings, empty or missing ones."""

from adversarial.beads import BEADS, scene
from adversarial.case import Case


def file_case(name: str, text: str, content: str | bytes, *patterns: str, **more) -> Case:
    """Case of `granflow check` of a scene file with this content."""
    return Case(
        "scene files", name, text, ("check beads.yaml",), patterns=patterns, prepare=scene(content), **more
    )


def no_scene(sandbox) -> None:
    sandbox.path("beads.yaml").unlink(missing_ok=True)


def file_cases() -> list[Case]:
    """Files that are empty, binary or missing."""
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
        file_case(
            "crlf_bom",
            "a valid scene with CR LF line ends and a byte order mark",
            b"\xef\xbb\xbf" + BEADS.replace("\n", "\r\n").encode(),
            "no problems",
            code=0,
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


CASES = file_cases()
