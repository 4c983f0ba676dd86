"""sapien's PhysX on any machine, with or without graphics libraries.

sapien links its renderer, and so libX11, even where only PhysX is used; a server or a container often has no
libX11. Nothing here ever calls it, so an empty library of that name is enough, with its functions bound
lazily: never.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import sys
import tempfile
import warnings
from pathlib import Path
from types import ModuleType

from grainfall.errors import InputError

X11 = "libX11.so.6"


def load() -> ModuleType:
    """The sapien module.

    Raises
    ------
    InputError
        When sapien is not installed, or needs a library that this machine lacks.
    """
    if importlib.util.find_spec("sapien") is None:
        raise InputError("packing.engine", "physx needs the package sapien", "install it, or choose bullet")
    flags = sys.getdlopenflags()
    try:
        ctypes.CDLL(X11)
    except OSError:
        _stand_in()
        sys.setdlopenflags(os.RTLD_LAZY)
    try:
        with warnings.catch_warnings():
            # it looks for a Vulkan loader on import; nothing is rendered here
            warnings.simplefilter("ignore")
            import sapien
    except ImportError as fault:
        raise InputError(
            "packing.engine", f"physx cannot be loaded ({fault})", "install that library, or choose bullet"
        ) from None
    finally:
        sys.setdlopenflags(flags)
    return sapien


def _stand_in() -> None:
    """Load a small library of sapien's own under the name of the missing one."""
    folder = Path(importlib.util.find_spec("sapien").origin).parents[1] / "sapien.libs"
    for source in sorted(folder.glob("liblzma-*")):
        name = source.name.encode() + b"\0"
        renamed = source.read_bytes().replace(name, X11.encode().ljust(len(name), b"\0"))
        with tempfile.TemporaryDirectory() as place:
            library = Path(place) / X11
            library.write_bytes(renamed)
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        return
