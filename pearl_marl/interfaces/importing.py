"""Something to do once a library has been imported, now or later, by any module."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


def when_imported(library: str, call: Callable[[], None]) -> None:
    """Call a function as soon as a library has been imported: at once if it has been already."""
    if library in sys.modules:
        call()
    else:
        sys.meta_path.insert(0, _Watch(library, call))


class _Watch(MetaPathFinder):
    """Finds a library where the other finders do, and is told when it has been executed."""

    def __init__(self, library: str, call: Callable[[], None]) -> None:
        self.library, self._call = library, call
        self._asking = False

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self.library or self._asking:
            return None
        self._asking = True  # another watch of the library asks all finders too, and so this one
        try:
            spec = next(
                filter(None, (each.find_spec(fullname, path, target) for each in sys.meta_path)), None
            )
        finally:
            self._asking = False
        if spec is not None and spec.loader is not None:
            spec.loader = _Watched(spec.loader, self._imported)
        return spec

    def _imported(self) -> None:
        if self in sys.meta_path:
            sys.meta_path.remove(self)
        self._call()


class _Watched(Loader):
    """Loads a module by its own loader, which the module then keeps, and has what that has besides."""

    def __init__(self, loader: Loader, then: Callable[[], None]) -> None:
        self._loader, self._then = loader, then

    def __getattr__(self, name: str) -> Any:
        # Some ask for data or source of a library that is not imported yet.
        if name == "_loader":
            raise AttributeError(name)
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: Any) -> None:
        module.__loader__ = module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        self._then()
