# SPDX-License-Identifier: Apache-2.0
# The types in src/redrive/python/__init__.pyi name what the module has, with the same arguments.
import ast
import pathlib
import re
import sys
import unittest

import redrive


def of_stubs(path):
    """Names of the stub with their arguments: {"Camera.project": ["points"], "Error": None}."""
    names = {}

    def arguments(function):
        a = function.args
        return [x.arg for x in a.posonlyargs + a.args + a.kwonlyargs if x.arg != "self"]

    for node in ast.parse(pathlib.Path(path).read_text()).body:
        if isinstance(node, ast.FunctionDef):
            names[node.name] = arguments(node)
        if not isinstance(node, ast.ClassDef):
            continue
        names[node.name] = None
        for part in node.body:
            if isinstance(part, ast.FunctionDef):
                is_property = any(getattr(d, "id", "") == "property" for d in part.decorator_list)
                names[f"{node.name}.{part.name}"] = None if is_property else arguments(part)
    return names


def of_module():
    def arguments(function):
        signature = function.__doc__.split("\n", 1)[0]
        inside = signature[signature.index("(") + 1 : signature.rindex(") ->")]
        inside = re.sub(r"\[[^\[\]]*\]", "", re.sub(r"\[[^\[\]]*\]", "", inside))
        names = [part.split(":")[0].split("=")[0].strip() for part in inside.split(", ")]
        return [n for n in names if re.fullmatch(r"\w+", n) and n not in ("self", "arg0")]

    names = {}
    for name, value in vars(redrive).items():
        if name.startswith("_"):
            continue
        names[name] = None if isinstance(value, type) else arguments(value)
        if not isinstance(value, type) or issubclass(value, Exception):
            continue
        for part, what in vars(value).items():
            if part == "__init__" and value is not redrive.Camera or part == "__repr__":
                continue
            if isinstance(what, property):
                names[f"{name}.{part}"] = None
            elif callable(what) and (not part.startswith("_") or part in ("__len__", "__init__")):
                names[f"{name}.{part}"] = arguments(what)
    return names


class Stubs(unittest.TestCase):
    def test_agree_with_the_module(self):
        stubs = of_stubs(redrive.__file__.rsplit("/", 1)[0] + "/__init__.pyi")
        module = of_module()
        self.assertGreater(len(module), 80)
        self.assertEqual(sorted(stubs), sorted(module))
        for name, arguments in module.items():
            self.assertEqual(stubs[name], arguments, name)

    def test_everything_has_help(self):
        for name in of_module():
            value = redrive
            for part in name.split("."):
                value = getattr(value, part)
            self.assertGreater(len(value.__doc__ or ""), 2, name)


if __name__ == "__main__":
    sys.exit(unittest.main())
