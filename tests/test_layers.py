"""Structure of the package: imports between layers, layers that use Taichi."""

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "granflow"
LAYERS = (
    "errors", "arguments", "processors", "taichi_patches", "kernel_language", "device_functions", "visible_text", "units",
    "fields", "snapshot", "schema", "io", "geometry", "contact", "scene", "particles", "load", "plan",
    "engine", "parallel", "observers", "runs", "live", "simulation", "studies", "importing", "cli", "__main__"
)  # fmt: skip
"""From the lowest layer to the highest. The __init__ of the package re-exports names of all layers."""
TAICHI_LAYERS = {"device_functions", "contact", "geometry", "scene", "engine"}
STUDIES_IMPORT = {
    "granflow", "granflow.arguments", "granflow.contact.material", "granflow.contact.registry",
    "granflow.contact.theory", "granflow.errors", "granflow.fields", "granflow.geometry.sphere",
    "granflow.load", "granflow.plan.cost", "granflow.plan.restitution", "granflow.runs.initial_particles", "granflow.scene.reader", "granflow.scene.run_numbers", "granflow.schema.document", "granflow.schema.faults", "granflow.schema.messages",
    "granflow.schema.model", "granflow.schema.quantities", "granflow.units", "granflow.visible_text"
}  # fmt: skip
"""Modules that studies may import, in addition to `granflow.studies`, `granflow.io` and
`granflow.scene.blocks`."""
TAICHI_DECORATORS = {"func", "kernel", "real_func", "pyfunc"}


def module_name(path):
    """The dotted name of the module at a path."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules():
    """Every module of the package: its dotted name, path and syntax tree."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return {module_name(path): (path, ast.parse(path.read_text(encoding="utf-8"))) for path in paths}


@cache
def imports(name):
    """The absolute dotted names of all imports in a module; submodules rather than their packages."""
    path, tree = modules()[name]
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            stem = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*stem, *([node.module] if node.module else [])])
            inner = [f"{base}.{alias.name}" for alias in node.names]
            found += [each if each in modules() else base for each in inner]
    return found


def layer(name):
    """The layer of a module of the package; None for the __init__ of the package and for other modules."""
    parts = name.split(".")
    return parts[1] if parts[0] == "granflow" and len(parts) > 1 else None


def test_modules_import_only_from_lower_layers():
    assert not {name for name in modules() if layer(name) not in (None, *LAYERS)}
    upward = [
        f"{name} imports {target}"
        for name in modules()
        for target in imports(name)
        if layer(name) and target.startswith("granflow")
        if layer(target) is None or LAYERS.index(layer(target)) > LAYERS.index(layer(name))
        if not (target == "granflow" and layer(name) in {"studies", "cli", "__main__"})
    ]
    assert not upward


def test_studies_import_only_the_public_interface():
    packages = ("granflow.studies", "granflow.io.", "granflow.scene.blocks.")
    internal = [
        f"{name} imports {target}"
        for name in modules()
        for target in imports(name)
        if layer(name) == "studies" and target.startswith("granflow")
        if target not in STUDIES_IMPORT and not target.startswith(packages)
    ]
    assert not internal


def test_imports_have_no_cycles():
    below = {name: {t for t in imports(name) if t in modules() and t != "granflow"} for name in modules()}
    below["granflow"] = set()
    while free := {name for name, targets in below.items() if not targets}:
        below = {name: targets - free for name, targets in below.items() if name not in free}
    assert not below


def test_one_module_imports_the_kernel_language():
    packages = {"taichi", "quadrants"}
    assert not [name for name in modules() if packages & {target.split(".")[0] for target in imports(name)}]
    users = {name for name in modules() if uses_kernel_language(name)}
    assert {layer(name) for name in users} == TAICHI_LAYERS


def uses_kernel_language(name):
    """True if a module imports `ti`, or reads it as an attribute of the module of the kernel language."""
    path, _ = modules()[name]
    imported = (
        r"^from granflow\.(kernel_language|device_functions) import [^\n]*\bti\b|\bkernel_language\.ti\b"
    )
    return re.search(imported, path.read_text(encoding="utf-8"), re.MULTILINE) is not None


def is_annotated(node):
    """Whether a function has types, or is compiled by Taichi."""
    names = {ast.unparse(each).split("(")[0].split(".")[-1] for each in node.decorator_list}
    spread = [each for each in (node.args.vararg, node.args.kwarg) if each]
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs, *spread]
    missing = [each for each in given if each.annotation is None and each.arg not in {"self", "cls"}]
    has_types = not missing and (node.returns is not None or node.name == "__init__")
    return has_types or bool(names & TAICHI_DECORATORS)


def test_host_functions_of_the_taichi_layers_are_annotated():
    """The linter enforces annotations in the other layers."""
    trees = {name: tree for name, (_, tree) in modules().items() if layer(name) in TAICHI_LAYERS}
    functions = [(name, node) for name, tree in trees.items() for node in ast.walk(tree)]
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    bare = [
        f"{name}:{node.lineno}"
        for name, node in functions
        if isinstance(node, kinds) and not is_annotated(node)
    ]
    assert not bare
