"""Names and modules of a package that load when they are first used, and that ``dir()`` and ``help()`` show.

A package's ``__init__`` takes both functions that the language looks for from here::

    __getattr__, __dir__ = lazy_names(__name__, {"viewer": ("Viewer",)})
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from collections.abc import Callable, Mapping, Sequence

PackageFunctions = tuple[Callable[[str], object], Callable[[], list[str]]]
"""``__getattr__`` and ``__dir__`` of a package."""


def lazy_names(
    package: str,
    modules: Mapping[str, Sequence[str]],
) -> PackageFunctions:
    """Return the functions of a package that exports names of its modules.

    Args:
        package: full name.
        modules: exported names by the module that defines them, relative to the package.
    """
    module_of = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> object:
        if name in module_of:
            return getattr(importlib.import_module(f"{package}.{module_of[name]}"), name)
        raise _unknown(package, name)

    return find, lambda: _shown(package, module_of)


def lazy_modules(package: str) -> PackageFunctions:
    """Return the functions of a package whose modules are imported one by one: its attributes are the modules.

    Args:
        package: full name.
    """

    def names() -> list[str]:
        path = sys.modules[package].__path__
        return [module.name for module in pkgutil.iter_modules(path) if not module.name.startswith("_")]

    def find(name: str) -> object:
        if name.startswith("_") or name not in names():
            raise _unknown(package, name)
        try:
            return importlib.import_module(f"{package}.{name}")
        except ModuleNotFoundError as error:
            # An attribute that cannot be had, so that help() shows the others.
            raise AttributeError(f"module '{package}.{name}' needs '{error.name}', which is not installed") from error

    return find, lambda: _shown(package, names())


def _unknown(package: str, name: str) -> AttributeError:
    return AttributeError(f"module '{package}' has no attribute '{name}'")


def _shown(package: str, names: Sequence[str] | Mapping[str, str]) -> list[str]:
    """Return the names that ``dir()`` shows: those given, those of ``__all__``, and the module's special ones."""
    module = vars(sys.modules[package])
    return sorted({*names, *module.get("__all__", ()), *(name for name in module if name.startswith("__"))})
