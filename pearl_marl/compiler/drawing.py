"""A scheduled core as a picture: a column a stage, operations as boxes, and what goes from one to another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape

from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.scheduling import Schedule
from pearl_marl.compiler.widths import width
from pearl_marl.golden.tracing.nodes import Node

BOX, GAP, ROW, MARGIN = 120, 34, 30, 46
COLOURS = {"input": "#d7e8f7", "mul": "#f7d9c4", "sum": "#fbeecb", "table": "#e3dcf3", "choose": "#d9f0dd"}
SYMBOLS = {
    "sum": "+", "mul": "*", "and": "&", "or": "|", "xor": "^", "equal": "=", "less": "<", "choose": "?:",
    "table": "[ ]", "left_by": "<<", "right_by": ">>", "word": "{ }",
}  # fmt: skip


def drawing(title: str, outputs: Sequence[Output], schedule: Schedule) -> str:
    """Return an SVG of a core; a register is where a line crosses from a stage to the next."""
    depth: dict[Node, int] = {}
    sources = schedule.sources
    below = {n: list(dict.fromkeys(s for a in n.args for s in sources[a])) for n in schedule.order}
    for node in schedule.order:
        same = [depth[s] for s in below[node] if schedule.stage[s] == schedule.stage[node]]
        depth[node] = max(same, default=-1) + 1
    columns = {(schedule.stage[n], depth[n]) for n in schedule.order}
    x = {key: MARGIN + i * (BOX + GAP) for i, key in enumerate(sorted(columns))}
    end = MARGIN + len(columns) * (BOX + GAP)
    rows: Counter[tuple[int, int]] = Counter()
    places: dict[Node, tuple[int, int]] = {}
    for node in schedule.order:
        key = schedule.stage[node], depth[node]
        places[node] = x[key], MARGIN + rows[key] * ROW
        rows[key] += 1
    lines = [_line(places[s], places[n]) for n in schedule.order for s in below[n]]
    boxes = [_box(places[n], _label(n), width(n, schedule.used), n.op, _hint(n)) for n in schedule.order]
    several = sum(output.port == "terminated_o" for output in outputs) > 1
    for i, output in enumerate(outputs):
        at = end, MARGIN + i * ROW
        lines += (_line(places[s], at) for s in sources[output.node])
        whole = output.port in ("reward_o", "terminated_o") and not several  # of one field
        label = output.port if whole else f"{output.port}.{output.field}"
        boxes.append(_box(at, label, output.bits, "output", label))
    height = MARGIN + max([*rows.values(), len(outputs)]) * ROW + 20
    stages = []
    for stage in range(schedule.latency):
        left = min((x[key] for key in columns if key[0] == stage), default=None)
        if left is not None:
            stages.append(f'<text x="{left}" y="34" class="stage">stage {stage}</text>')
            if stage:
                edge = left - GAP // 2
                stages.append(f'<line x1="{edge}" y1="24" x2="{edge}" y2="{height}" class="edge"/>')
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{end + BOX + MARGIN}" height="{height}">',
            "<style>text{font:11px sans-serif}.title{font-size:14px}.stage{fill:#666}"
            ".edge{stroke:#bbb;stroke-dasharray:4}path{stroke:#999;fill:none;stroke-width:.7}"
            "rect{stroke:#777;stroke-width:.7}</style>",
            '<rect width="100%" height="100%" fill="white" style="stroke:none"/>',
            f'<text x="{MARGIN}" y="16" class="title">{escape(title)}</text>',
            *stages,
            *lines,
            *boxes,
            "</svg>\n",
        ]
    )


def _label(node: Node) -> str:
    if node.op == "input":
        return str(node.imm)
    return f"{node.name} {SYMBOLS[node.op]}" if node.name else SYMBOLS[node.op]


def _hint(node: Node) -> str:
    place = f", line {node.line}" if node.line else ""
    return f"{node.op}{place}, {node.low} to {node.high}"


def _box(place: tuple[int, int], label: str, bits: int, op: str, hint: str) -> str:
    x, y = place
    colour = COLOURS.get(op, "#f4f4f4")
    short = label if len(label) <= 16 else f"{label[:15]}…"
    return (
        f"<g><title>{escape(hint)}</title>"
        f'<rect x="{x}" y="{y}" width="{BOX}" height="20" rx="3" fill="{colour}"/>'
        f'<text x="{x + 4}" y="{y + 14}">{escape(short)}</text>'
        f'<text x="{x + BOX - 4}" y="{y + 14}" text-anchor="end" fill="#777">{bits}</text></g>'
    )


def _line(start: tuple[int, int], end: tuple[int, int]) -> str:
    x, y = start[0] + BOX, start[1] + 10
    to_x, to_y = end[0], end[1] + 10
    return f'<path d="M{x} {y}C{x + GAP} {y} {to_x - GAP} {to_y} {to_x} {to_y}"/>'
