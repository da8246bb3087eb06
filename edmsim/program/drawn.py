"""What of a drawing is cut: entities on layers that are shown and asked for, blocks taken apart."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from edmsim.errors import InputError
from edmsim.program.entities import CUT
from edmsim.program.limits import MOST_POINTS

if TYPE_CHECKING:
    from ezdxf.document import Drawing

_DEEPEST = 16
"""Blocks within blocks (ours: deeper ones hold themselves)."""

_MOST_TOLD = 20

_EQUAL = 1e-9
"""Angles that differ by less, in degrees or radians, are equal; so are radii and 0 (ours: what arithmetic leaves)."""


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
        self._refuse_unknown_layers()
        self._shrink_points()
        self._unmoved = {block.name: _taken_out(block) for block in document.blocks}

    def __iter__(self) -> Iterator[Any]:
        """Go through them, in the order of the file."""
        for entity in self._document.modelspace():
            yield from self._parts(entity, _property(entity, "layer", "0"), 0)

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
        if self._is_frozen(layer) or _property(entity, "invisible", 0):
            self.leave_out("INSERT on a layer that is off")
            return
        copies = entity.multi_insert() if entity.mcount > 1 else [entity]
        for copy in copies:
            for part in (*copy.virtual_entities(), *self._unmoved[entity.block().name]):
                self._count += 1
                if self._count > MOST_POINTS:
                    raise InputError(f"its blocks hold more than {MOST_POINTS} entities: no cut has so many")
                own = _property(part, "layer", "0")
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
        if layer.lower() == "defpoints" or _property(entity, "invisible", 0):
            return False
        layers = self._document.layers
        return not layers.has_entry(layer) or bool(layers.get(layer).is_on() and not layers.get(layer).is_frozen())

    def _is_frozen(self, layer: str) -> bool:
        layers = self._document.layers
        return layers.has_entry(layer) and bool(layers.get(layer).is_frozen())

    def _shrink_points(self) -> None:
        """Make arcs with equal angles the points that CAD programs draw: the library makes them full circles."""
        blocks: Any = self._document.blocks
        for block in blocks:
            for arc in block.query("ARC"):
                if math.isclose(arc.dxf.start_angle, arc.dxf.end_angle, abs_tol=_EQUAL):
                    arc.dxf.radius = 0.0
            for ellipse in block.query("ELLIPSE"):
                if math.isclose(ellipse.dxf.start_param, ellipse.dxf.end_param, abs_tol=_EQUAL):
                    common = {name: ellipse.dxf.get(name) for name in ("layer", "invisible")}
                    block.add_arc(ellipse.dxf.center, 0.0, 0.0, 0.0, dxfattribs=common)
                    block.delete_entity(ellipse)

    def _refuse_unknown_layers(self) -> None:
        blocks = (entity for block in self._document.blocks for entity in block)
        there = {str(entity.dxf.layer) for entity in blocks if entity.dxf.hasattr("layer")}
        there |= {layer.dxf.name for layer in self._document.layers} | {"0"}
        unknown = self._layers - {name.lower() for name in there}
        if unknown:
            told = ", ".join(sorted(there)[:_MOST_TOLD]) + (", ..." if len(there) > _MOST_TOLD else "")
            raise InputError(f"the drawing has no layer {', '.join(sorted(unknown))}; there are: {told}")


def _taken_out(block: Any) -> list[Any]:
    """Take out of a block what is not cut: the library drops, explodes or fails on some of it when it moves it."""
    others = [] if block.is_any_layout else [
        entity for entity in block
        if entity.dxftype() not in CUT | {"INSERT"}
        or (entity.dxftype() in ("ARC", "CIRCLE") and abs(entity.dxf.radius) < _EQUAL)
    ]
    for entity in others:
        block.unlink_entity(entity)
    return others


def _property(entity: Any, name: str, default: Any) -> Any:
    """Return what all entities have; the library keeps it elsewhere for kinds that it does not know."""
    if entity.dxf.is_supported(name):
        return entity.dxf.get(name, default)
    return entity.graphic_properties().get(name, default)
