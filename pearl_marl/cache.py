"""The user's cache folder: compiled kernels and simulated devices are kept there between runs.

``PEARL_CACHE_DIR`` moves it.
"""

from __future__ import annotations

import functools
import os
import tempfile
from pathlib import Path

import platformdirs


@functools.cache
def cache_folder(name: str) -> Path:
    """Return the folder of that name in the cache; a temporary one if the cache cannot be written."""
    folder = Path(os.environ.get("PEARL_CACHE_DIR") or platformdirs.user_cache_dir("pearl_marl")) / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:  # a read-only home costs a compilation in every process, and no more
        return Path(tempfile.mkdtemp(prefix=f"pearl_marl_{name}_"))
