"""Result dicts as trees: JAX and PyTorch see their agents, and not one leaf.

Both go by the very class of a container, so a subclass of ``dict`` is a leaf to them until they are told.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pearl_marl.interfaces.importing import when_imported


def register_dict(kind: type[dict[str, Any]]) -> None:
    """Tell JAX and PyTorch, once they have been imported, that a class is a dict.

    What they make of such trees are plain dicts.
    """
    when_imported("torch", lambda: _register_with_torch(kind))
    when_imported("jax", lambda: _register_with_jax(kind))


def _parts(container: dict[str, Any]) -> tuple[list[Any], tuple[str, ...]]:
    return list(container.values()), tuple(container)


def _register_with_torch(kind: type[dict[str, Any]]) -> None:
    from torch.utils import _pytree as trees

    def made(values: Iterable[Any], names: tuple[str, ...]) -> dict[str, Any]:
        return dict(zip(names, values, strict=True))

    def with_keys(container: dict[str, Any]) -> tuple[list[tuple[Any, Any]], tuple[str, ...]]:
        values, names = _parts(container)
        return [(trees.MappingKey(name), value) for name, value in zip(names, values, strict=True)], names

    trees.register_pytree_node(kind, _parts, made, flatten_with_keys_fn=with_keys)


def _register_with_jax(kind: type[dict[str, Any]]) -> None:
    from jax import tree_util as trees

    def made(names: tuple[str, ...], values: Iterable[Any]) -> dict[str, Any]:
        return dict(zip(names, values, strict=True))

    def with_keys(container: dict[str, Any]) -> tuple[list[tuple[Any, Any]], tuple[str, ...]]:
        values, names = _parts(container)
        return [(trees.DictKey(name), value) for name, value in zip(names, values, strict=True)], names

    trees.register_pytree_with_keys(kind, with_keys, made, _parts)
