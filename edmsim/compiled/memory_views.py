"""Addresses in compiled code: memory at an address as arrays or groups of arrays, and calls of functions."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, register_model

from edmsim.compiled.numba_internals import AttributeTemplate, cgutils, datamodel, populate_array


class GroupField(NamedTuple):
    """One field of a group: type of its elements, and shape as numbers and names of lengths; None for a scalar."""

    dtype: np.dtype[Any]
    shape: tuple[int | str, ...] | None


def rows_of(dtype: np.dtype[Any]) -> Any:
    """Return a function that makes an array of such elements from an address and a shape, in compiled code."""
    of = from_dtype(dtype)

    @intrinsic
    def rows(_context: Any, address: Any, shape: Any) -> Any:
        kind = types.Array(of, len(shape), "C")

        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            place, sizes = arguments
            numbers = zip(cgutils.unpack_tuple(builder, sizes), shape, strict=True)
            lengths = [context.cast(builder, value, from_, types.intp) for value, from_ in numbers]
            return _array(context, builder, kind, place, lengths)

        return kind(types.int64, shape), generate

    return rows


def group_of(name: str, table: np.dtype[np.void], fields: dict[str, GroupField], lengths: Sequence[str]) -> Any:
    """Return a function that makes a group from its record in a table and a tuple of lengths, in compiled code."""
    # A field is read from the record where it is used. Passed as a tuple of arrays, a group would add some 600
    # arguments to every call, which takes a third of the compile time.
    made = _Group(name, table, fields, lengths)

    @intrinsic
    def group(_context: Any, record: Any, numbers: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            parts = cgutils.create_struct_proxy(made)(context, builder)
            parts.record = builder.bitcast(arguments[0], parts.record.type)
            values = cgutils.unpack_tuple(builder, arguments[1])
            for length, value, from_ in zip(lengths, values, numbers, strict=True):
                setattr(parts, length, context.cast(builder, value, from_, types.intp))
            return parts._getvalue()

        return made(record, numbers), generate

    return group


class _Group(types.Type):  # type: ignore[misc]
    """Type of a group: the address of its record, and its lengths."""

    def __init__(
        self, name: str, table: np.dtype[np.void], fields: dict[str, GroupField], lengths: Sequence[str]
    ) -> None:
        self.table = from_dtype(table)
        self.fields = fields
        self.lengths = lengths
        super().__init__(name=name)

    def kind(self, field: str) -> Any:
        """Return the type of a field."""
        dtype, shape = self.fields[field]
        of = from_dtype(dtype)
        return of if shape is None else types.Array(of, len(shape), "C")


@register_model(_Group)
class _GroupModel(datamodel.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, group: Any) -> None:
        super().__init__(manager, group, [("record", types.voidptr), *((n, types.intp) for n in group.lengths)])


@infer_getattr
class _GroupFields(AttributeTemplate):  # type: ignore[misc]
    key = _Group

    def generic_resolve(self, group: Any, field: str) -> Any:
        """Return the type of a field; None if the group has none of that name."""
        return group.kind(field) if field in group.fields else None


@lower_getattr_generic(_Group)
def _field(context: Any, builder: Any, group: Any, value: Any, field: str) -> Any:
    """Read a number, or the address of an array, in the record."""
    parts, kind = cgutils.create_struct_proxy(group)(context, builder, value=value), group.kind(field)
    shape = group.fields[field].shape
    entry = context.get_data_type(kind if shape is None else types.int64)
    place = cgutils.pointer_add(builder, parts.record, group.table.offset(field), entry.as_pointer())
    found = builder.load(place)
    found.set_metadata("invariant.load", builder.module.add_metadata([]))
    if shape is None:
        return found
    lengths = [getattr(parts, n) if isinstance(n, str) else context.get_constant(types.intp, n) for n in shape]
    return _array(context, builder, kind, found, lengths)


def _array(context: Any, builder: Any, kind: Any, address: Any, lengths: list[Any]) -> Any:
    view = context.make_array(kind)(context, builder)
    size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
    strides = [context.get_constant(types.intp, size)]
    for length in lengths[:0:-1]:
        strides.insert(0, builder.mul(strides[0], length))
    populate_array(
        view, data=builder.inttoptr(address, view.data.type), shape=lengths, strides=strides,
        itemsize=context.get_constant(types.intp, size), meminfo=None,
    )  # fmt: skip
    return view._getvalue()


@intrinsic
def call_with_two(_context: Any, _function: Any, _first: Any, _second: Any) -> Any:
    """Call ``void function(void *first, void *second)``, all three given as addresses (int64)."""
    # addresses are passed at run time, so cached machine code stays valid
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [address, address])
        target = builder.inttoptr(arguments[0], kind.as_pointer())
        builder.call(target, [builder.inttoptr(argument, address) for argument in arguments[1:]])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate

