"""Calls from compiled code of functions that are known by their address only."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _calling(typingctx: Any, function: Any, first: Any, second: Any) -> Any:
    """Machine code for a call of ``void function(first, second)``, all three given as addresses.

    The addresses are values at run time, so machine code kept between runs stays right.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [address, address])
        target = builder.inttoptr(arguments[0], kind.as_pointer())
        builder.call(target, [builder.inttoptr(argument, address) for argument in arguments[1:]])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


call_with_two: Any = intrinsic(_calling)
"""Call ``void function(void *, void *)``; takes three addresses (int64)."""
