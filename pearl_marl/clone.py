"""In a clone, four folders of the package lie beside it; whoever imports it there finds them all the same."""

from __future__ import annotations

import os
import sys

_PATH = sys.modules["pearl_marl"].__path__

if not os.path.isdir(os.path.join(_PATH[0], "envs")):
    _PATH.append(os.path.dirname(_PATH[0]))
