"""The arguments that a docstring describes are those that the signature has."""

import ast
import re

from tests.house.test_layers import MODULES, parsed

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


def nodes(module, *kinds):
    return [node for node in ast.walk(parsed(module)) if isinstance(node, kinds)]


def test_no_docstring_describes_an_argument_that_is_not_there():
    wrong = []
    for module in MODULES:
        classes = {node.name: node for node in nodes(module, ast.ClassDef)}
        wrong += [
            f"{module}: {node.name}: {name}"
            for node in nodes(module, ast.FunctionDef, ast.ClassDef)
            if (names := taken(node, classes))
            for name in described(node)
            if name not in names
        ]
    assert wrong == []


def says(name, node, classes):
    """Tell whether a method of a class, or the one that it overrides, says what it does."""
    own = [b for b in node.body if isinstance(b, ast.FunctionDef) and b.name == name]
    bases = [classes[b.id] for b in node.bases if isinstance(b, ast.Name) and b.id in classes]
    return any(map(ast.get_docstring, own)) or any(says(name, base, classes) for base in bases)


def test_a_public_method_says_what_it_does_unless_the_one_that_it_overrides_does():
    classes = {node.name: node for module in MODULES for node in nodes(module, ast.ClassDef)}
    silent = [
        f"{owner}.{b.name}"
        for owner, node in classes.items()
        for b in node.body
        if isinstance(b, ast.FunctionDef) and "_" not in (owner[0], b.name[0])
        if not says(b.name, node, classes)
    ]
    assert silent == []
