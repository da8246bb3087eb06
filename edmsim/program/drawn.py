"""What of a drawing is cut: entities on layers that are shown and asked for, blocks taken apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from edmsim.errors import InputError
from edmsim.program.limits import MOST_POINTS

if TYPE_CHECKING:
    from ezdxf.document import Drawing

_DEEPEST = 16
"""Blocks within blocks (ours: deeper ones hold themselves)."""

_MOST_TOLD = 20


class Drawn:
    """The entities of a drawing's model space that are to be cut.

    Parameters
    ----------
    document : ezdxf.document.Drawing
    layers : sequence of str
        Only these are cut, upper or lower case; all that are shown if empty.

    Attributes
    ----------
    left_out : dict of str to int
        What was not cut, with its number.

    Raises
    ------
    InputError
        A layer that the drawing does not have.
    """

    def __init__(self, document: Drawing, layers: Sequence[str]) -> None:
        self._document = document
        self._layers = frozenset(name.strip().lower() for name in layers)
        self.left_out: dict[str, int] = {}
        self._count = 0

    def __iter__(self) -> Iterator[Any]:
        """Go through them, in the order of the file."""
        self._refuse_unknown_layers()
        for entity in self._document.modelspace():
            yield from self._parts(entity, entity.dxf.layer, 0)

    def leave_out(self, kind: str) -> None:
        """Count what is not cut."""
        self.left_out[kind] = self.left_out.get(kind, 0) + 1

    def _parts(self, entity: Any, layer: str, depth: int) -> Iterator[Any]:
        """Return an entity, or those of its block; what lies on layer 0 in a block is on the layer of the block."""
        kind = entity.dxftype()
        if kind != "INSERT":
            if self._is_cut(entity, kind, layer):
                yield entity
            return
        if depth > _DEEPEST:
            raise InputError(f"the block {entity.dxf.name} lies in itself, or over {_DEEPEST} deep: explode it")
        if entity.block() is None:
            raise InputError(f"the block {entity.dxf.name} is not in the drawing: bind external references and save")
        if self._is_frozen(layer) or entity.dxf.get("invisible", 0):
            self.leave_out("INSERT on a layer that is off")
            return
        copies = entity.multi_insert() if entity.mcount > 1 else [entity]
        for copy in copies:
            for part in copy.virtual_entities():
                self._count += 1
                if self._count > MOST_POINTS:
                    raise InputError(f"its blocks hold more than {MOST_POINTS} entities: no cut has so many")
                own = part.dxf.layer
                yield from self._parts(part, layer if own == "0" else own, depth + 1)

    def _is_cut(self, entity: Any, kind: str, layer: str) -> bool:
        if not self._is_shown(entity, layer):
            self.leave_out(f"{kind} on a layer that is off")
        elif self._layers and layer.lower() not in self._layers:
            self.leave_out(f"{kind} on a layer not asked for")
        else:
            return True
        return False

    def _is_shown(self, entity: Any, layer: str) -> bool:
        if layer.lower() == "defpoints" or entity.dxf.get("invisible", 0):
            return False
        layers = self._document.layers
        return not layers.has_entry(layer) or bool(layers.get(layer).is_on() and not layers.get(layer).is_frozen())

    def _is_frozen(self, layer: str) -> bool:
        layers = self._document.layers
        return layers.has_entry(layer) and bool(layers.get(layer).is_frozen())

    def _refuse_unknown_layers(self) -> None:
        blocks = (entity for block in self._document.blocks for entity in block)
        there = {str(entity.dxf.layer) for entity in blocks if entity.dxf.hasattr("layer")}
        there |= {layer.dxf.name for layer in self._document.layers} | {"0"}
        unknown = self._layers - {name.lower() for name in there}
        if unknown:
            told = ", ".join(sorted(there)[:_MOST_TOLD]) + (", ..." if len(there) > _MOST_TOLD else "")
            raise InputError(f"the drawing has no layer {', '.join(sorted(unknown))}; there are: {told}")
