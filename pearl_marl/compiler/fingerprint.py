"""What a function computes, as a hash: the cache tells a changed golden function from an unchanged one."""

from __future__ import annotations

import hashlib
import types
from typing import Any

import numpy as np

from pearl_marl.golden import GoldenFunction


def fingerprint(function: GoldenFunction) -> bytes:
    """Hash a function's code, and every function and constant that it names."""
    walk = _Walk()
    walk.visit(function)
    return walk.digest.digest()


class _Walk:
    """Goes through all that a function is made of, and every other function only once."""

    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        self.seen: set[types.FunctionType] = set()

    def visit(self, value: Any) -> None:
        value = getattr(value, "py_func", value)  # what Numba has compiled already
        if isinstance(value, types.FunctionType):
            if value not in self.seen:
                self.seen.add(value)
                self.visit_function(value)
        elif isinstance(value, np.ndarray):
            self.digest.update(repr((value.dtype, value.shape)).encode())
            self.digest.update(value.tobytes())
        elif isinstance(value, (int, float, str, bytes, tuple, np.generic, type(None))):
            self.digest.update(repr(value).encode())

    def visit_function(self, function: types.FunctionType) -> None:
        self.visit_code(function.__code__, function.__globals__)
        for default in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self.visit(default)
        for cell in function.__closure__ or ():
            self.visit(cell.cell_contents)

    def visit_code(self, code: types.CodeType, scope: dict[str, Any]) -> None:
        self.digest.update(code.co_code)
        self.digest.update(repr((code.co_names, code.co_varnames)).encode())
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):  # an inner function, whose repr holds its address
                self.visit_code(constant, scope)
            else:
                self.visit(constant)
        for name in code.co_names:
            value = scope.get(name)
            self.visit(value)
            if isinstance(value, types.ModuleType):
                for attribute in code.co_names:
                    constant = vars(value).get(attribute)
                    if not isinstance(constant, types.FunctionType):  # Numba knows these or refuses them
                        self.visit(constant)
