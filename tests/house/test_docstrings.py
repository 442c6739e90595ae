"""The arguments that a docstring describes are those that the signature has."""

import ast
import re

import pytest

from tests.house.test_layers import MODULES

SECTION = re.compile(r"^Args:\n((?: .*\n|\n)+)", re.MULTILINE)
ENTRY = re.compile(r"^    \*{0,2}(\w[\w, *]*):", re.MULTILINE)


def described(node):
    """Return the names below `Args:` in a docstring."""
    section = SECTION.search((ast.get_docstring(node) or "") + "\n")
    return re.findall(r"\w+", " ".join(ENTRY.findall(section[1]))) if section else []


def signature(function):
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return {a.arg for a in (*named, arguments.vararg, arguments.kwarg) if a is not None}


def taken(node, classes):
    """Return what a function takes; for a class its fields and the arguments of `__init__`.

    A class inherits those of the classes of its own module.
    """
    if isinstance(node, ast.FunctionDef):
        return signature(node)
    fields = {b.target.id for b in node.body if isinstance(b, ast.AnnAssign)}
    methods = [b for b in node.body if isinstance(b, ast.FunctionDef) and b.name == "__init__"]
    bases = [classes[b.id] for b in node.bases if isinstance(b, ast.Name) and b.id in classes]
    return fields.union(*map(signature, methods), *(taken(base, classes) for base in bases))


@pytest.mark.parametrize("module", MODULES)
def test_no_docstring_describes_an_argument_that_is_not_there(module):
    nodes = list(ast.walk(ast.parse(MODULES[module].read_text())))
    classes = {node.name: node for node in nodes if isinstance(node, ast.ClassDef)}
    wrong = [
        f"{node.name}: {name}"
        for node in nodes
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and (names := taken(node, classes))
        for name in described(node)
        if name not in names
    ]
    assert wrong == []


CLASSES = {
    node.name: node
    for path in MODULES.values()
    for node in ast.walk(ast.parse(path.read_text()))
    if isinstance(node, ast.ClassDef)
}


def says(name, node):
    """Tell whether a method of a class, or the one that it overrides, says what it does."""
    own = [b for b in node.body if isinstance(b, ast.FunctionDef) and b.name == name]
    bases = [CLASSES[b.id] for b in node.bases if isinstance(b, ast.Name) and b.id in CLASSES]
    return any(map(ast.get_docstring, own)) or any(says(name, base) for base in bases)


def test_a_public_method_says_what_it_does_unless_the_one_that_it_overrides_does():
    silent = [
        f"{owner}.{b.name}"
        for owner, node in CLASSES.items()
        for b in node.body
        if isinstance(b, ast.FunctionDef) and "_" not in (owner[0], b.name[0])
        if not says(b.name, node)
    ]
    assert silent == []
