"""Fuse the maps of two robots that met; make the data to train and measure that on."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rendezvous.commands.fuse.from_python import fuse as fuse

_HOME = {"fuse": "rendezvous.commands.fuse.from_python"}
"""Where each public name is defined; imported when it is first asked for."""

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
