"""Calls of compiled functions by their address, and named tuples that compiled code finds by theirs.

Numba optimises all that a function calls together with it, however often it has been optimised before. A loop
that is given the address of what it calls, and of what that works on, compiles by itself, once for all
functions of that kind.
"""

from __future__ import annotations

import functools
from typing import Annotated, Any, get_origin, get_type_hints

import numba
import numpy as np
from numba import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop

_intrinsic: Any = intrinsic

_typeof: Any = numba.typeof
_named_tuple: Any = types.NamedTuple
_tuple: Any = types.BaseTuple

_SCALARS: dict[type, Any] = {bool: types.boolean, int: types.int64}


def address_of(function: Any, *arguments: Any) -> int:
    """Return the address of a function of Numba's for such arguments; it is compiled if need be.

    It stays there as long as the function does.
    """
    signature = tuple(map(_typeof, arguments))
    if signature not in function.overloads:
        function.compile(signature)
    made = function.overloads[signature]
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


def _caller(result: Any) -> Any:
    @_intrinsic  # type: ignore[untyped-decorator]
    def call(_: Any, address: Any, arguments: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            own = tuple(arguments)
            values = [builder.extract_value(operands[1], k) for k in range(len(own))]
            kind = context.call_conv.get_function_type(result, own)
            callee = builder.inttoptr(operands[0], kind.as_pointer())
            status, returned = context.call_conv.call_function(builder, callee, result, own, values)
            with builder.if_then(status.is_error):  # there is no memory left
                context.call_conv.return_status_propagate(builder, status)
            return returned

        return result(address, arguments), generate

    return call


call_step = _caller(types.uint8)
"""Call the kernel ``step`` at an address, with a tuple of its arguments."""

call_act = _caller(types.none)
"""Call what returns nothing at an address, with a tuple of its arguments."""


def _borrowed(context: Any, builder: Any, of: Any, value: Any) -> Any:
    """Return a value whose arrays do not say who owns them, so that nobody counts references to them."""
    if isinstance(of, _tuple):
        for k, kind in enumerate(of.types):
            part = _borrowed(context, builder, kind, builder.extract_value(value, k))
            value = builder.insert_value(value, part, k)
        return value
    if not isinstance(of, types.Array):
        return value
    array = context.make_array(of)(context, builder, value)
    for owner in ("meminfo", "parent"):
        null = context.get_constant_null(types.intp)
        setattr(array, owner, builder.inttoptr(null, getattr(array, owner).type))
    return array._getvalue()


@_intrinsic  # type: ignore[untyped-decorator]
def _store(_: Any, fields: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        value = _borrowed(context, builder, fields, operands[0])
        builder.store(value, builder.inttoptr(operands[1], value.type.as_pointer()))
        return context.get_dummy_value()

    return types.none(fields, address), generate


def _put(fields: Any, address: int) -> None:
    _store(fields, address)


_compiled_put = compiled_loop(_put)


def in_memory(fields: Any) -> Array:
    """Return memory, at whose address :func:`fields_at` finds the fields of a named tuple.

    The arrays among them have to be kept as long as it is used.
    """
    of_fields: Any = type(fields)
    kind, own = type_of(of_fields), _typeof(fields)
    if own != kind:
        raise TypeError(f"the fields are of the type {own}; it must be {kind}")
    memory = np.zeros(_words_of(kind), np.int64)
    _compiled_put()(fields, memory.ctypes.data)
    return memory


@functools.cache
def _words_of(kind: Any) -> int:
    """Return how many words of 64 bits a value of a type of Numba's takes."""
    context = cpu_target.target_context
    return -(-int(context.get_abi_sizeof(context.get_value_type(kind))) // 8)


def fields_at(kind: type) -> Any:
    """Return what reads, in compiled code, the fields of a kind of named tuple at an address.

    Each field is a ``bool``, an ``int``, such a tuple, or an array, annotated with Numba's type of it.
    """

    @_intrinsic  # type: ignore[untyped-decorator]
    def read(_: Any, address: Any) -> Any:
        fields = type_of(kind)

        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            value = context.get_value_type(fields)
            return builder.load(builder.inttoptr(operands[0], value.as_pointer()))

        return fields(address), generate

    return read


@functools.cache
def type_of(kind: Any) -> Any:
    """Return Numba's type of a kind of named tuple, by what its fields are annotated with."""
    if kind in _SCALARS:
        return _SCALARS[kind]
    hints = get_type_hints(kind, include_extras=True)
    of_fields = [
        hint.__metadata__[0] if get_origin(hint) is Annotated else type_of(hint) for hint in hints.values()
    ]
    return _named_tuple(of_fields, kind)
