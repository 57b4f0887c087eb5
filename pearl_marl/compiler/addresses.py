"""Calls of compiled functions by their address.

Numba optimises all that a function calls together with it, however often it has been optimised before. A loop
that is given the address of what it calls compiles by itself, once for all functions of that kind.
"""

from __future__ import annotations

from typing import Any

import numba
from numba import types
from numba.extending import intrinsic

_intrinsic: Any = intrinsic


def address_of(function: Any, *arguments: Any) -> int:
    """Return the address of a function of Numba's for such arguments; it is compiled if need be.

    It stays there as long as the function does.
    """
    signature = tuple(map(numba.typeof, arguments))
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
