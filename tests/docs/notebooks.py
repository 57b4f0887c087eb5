"""Run a notebook's cells as a kernel would, and put what they print into it.

    python tests/docs/notebooks.py examples/first_steps.ipynb

So the outputs are small, and the same wherever they are made; no kernel has to be installed.
"""

from __future__ import annotations

import contextlib
import io
import json
import linecache
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def run(notebook: Any) -> Iterator[tuple[Any, str]]:
    """Yield each cell of code with what it prints, one after the other."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] == "code":
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                text, name = "".join(cell["source"]), f"cell {number}"
                # Where a kernel keeps it for tracebacks, and the tracer reads it.
                linecache.cache[name] = len(text), None, text.splitlines(True), name
                exec(compile(text, name, "exec", dont_inherit=True), names)
            yield cell, printed.getvalue()


def output(text: str) -> list[Any]:
    """Return a cell's outputs as a notebook stores them."""
    return [{"name": "stdout", "output_type": "stream", "text": text.splitlines(True)}] if text else []


if __name__ == "__main__":
    for name in sys.argv[1:]:
        notebook = json.loads(Path(name).read_text())
        for count, (cell, text) in enumerate(run(notebook), 1):
            cell.update(outputs=output(text), execution_count=count)
        Path(name).write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")
