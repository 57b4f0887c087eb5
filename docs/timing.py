"""Draws the timing diagrams of docs/hardware.md from a run of the simulated device.

``python docs/timing.py`` takes two steps of CliffWalking, 16 slots on 4 processing elements with 32-bit
words, over the simulated AXI port, and draws the second one into ``docs/images``.
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np

import pearl_marl
from pearl_marl.devices import BatchConfig, Rtl

IMAGES = Path(__file__).parent / "images"
ROW, LABEL = 26, 200
BACKBONE = "u_backbone."

# A row is (label, signal, signal that says when it means something or None, way to print a value or
# None for a line that is high or low).
STEP_ROWS = (
    ("doorbell rings", BACKBONE + "ring", None, None),
    ("step runs (busy)", BACKBONE + "busy", None, None),
    ("group reader: issue", BACKBONE + "issue", None, None),
    ("issued group", BACKBONE + "issue_group", BACKBONE + "issue", str),
    ("at the cores' inputs", BACKBONE + "u_state_path.at_pe", "msb", lambda v: str(v & 3)),
    ("at their outputs, written back", BACKBONE + "u_state_path.at_result", "msb", lambda v: str(v & 3)),
    ("observations: word written", BACKBONE + "u_observations.waddr", BACKBONE + "u_observations.we", str),
    ("rewards: word written", BACKBONE + "u_rewards.waddr", BACKBONE + "u_rewards.we", str),
    ("ends: word written", BACKBONE + "u_ters.waddr", BACKBONE + "u_ters.we", str),
    ("all words are written (done)", BACKBONE + "done", None, None),
    ("status: sequence", BACKBONE + "u_registers.finished_q", "", str),
    ("irq_o", "irq_o", None, None),
)
AXI_ROWS = tuple(
    (name, f"s_axi_{name}", f"s_axi_{valid}" if valid else None, (lambda v: f"{v:x}") if valid else None)
    for name, valid in (
        ("awvalid", None),
        ("awready", None),
        ("awaddr", "awvalid"),
        ("wvalid", None),
        ("wready", None),
        ("wdata", "wvalid"),
        ("wlast", None),
        ("bvalid", None),
        ("bready", None),
    )
)
AXI_ROWS += (("irq_o", "irq_o", None, None),)
AXI_ROWS += tuple(
    (name, f"s_axi_{name}", f"s_axi_{valid}" if valid else None, (lambda v: f"{v:x}") if valid else None)
    for name, valid in (
        ("arvalid", None),
        ("arready", None),
        ("araddr", "arvalid"),
        ("rvalid", None),
        ("rready", None),
        ("rdata", "rvalid"),
        ("rlast", None),
    )
)


def run(vcd: Path) -> None:
    """Take two steps and leave their waveforms."""
    device = Rtl(4, 32, path="axi", trace=vcd)
    device.open(BatchConfig(spec=pearl_marl.get_spec("CliffWalking"), n_envs=16))
    device.reset(seed=0)
    for action in (0, 1):
        device.step(np.full(16, action, np.uint8))
    device.close()


def cycles(vcd: Path, wanted: set[str]) -> dict[str, list[int]]:
    """Return the value of each wanted signal in each cycle, as the clock edge that ends it sees it."""
    header, _, body = vcd.read_text().partition("$enddefinitions")
    scope: list[str] = []
    codes: dict[str, list[str]] = {}
    for line in header.splitlines():
        words = line.split()
        if words[:1] == ["$scope"]:
            scope.append(words[2])
        elif words[:1] == ["$upscope"]:
            scope.pop()
        elif words[:1] == ["$var"]:
            name = ".".join([*scope, words[4]]).partition("pearl_top.")[2]
            if name in wanted | {"clk_i"}:
                codes.setdefault(words[3], []).append(name)
    now = dict.fromkeys(wanted | {"clk_i"}, 0)
    trace: dict[str, list[int]] = {name: [] for name in now}
    for change in re.split(r"^#\d+$", body, flags=re.MULTILINE)[1:]:
        before = dict(now)
        for line in change.split("\n"):
            bits, code = line[1:].split() if line.startswith("b") else (line[:1], line[1:])
            for name in codes.get(code, ()):
                now[name] = int(bits, 2)
        if now["clk_i"] and not before["clk_i"]:
            for name, value in before.items():
                trace[name].append(value)
    missing = wanted - {name for names in codes.values() for name in names}
    if missing:
        raise SystemExit(f"the trace has no signals {sorted(missing)}")
    return trace


def draw(rows: tuple, trace: dict[str, list[int]], first: int, last: int, cell: int) -> str:
    """Draw the rows from cycle ``first`` to cycle ``last`` as an SVG picture."""
    count = last - first + 1
    width, height = LABEL + cell * count + 10, ROW * (len(rows) + 1) + 10
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for k in range(count):
        x = LABEL + cell * k
        parts.append(f'<path d="M{x} {ROW - 6}V{height - 6}" stroke="#ddd"/>')
        parts.append(
            f'<text x="{x + cell / 2}" y="15" text-anchor="middle" fill="#888" font-size="10">{k}</text>'
        )
    for number, (label, signal, valid, show) in enumerate(rows):
        top, bottom = ROW * (number + 1), ROW * (number + 1) + 16
        parts.append(f'<text x="{LABEL - 8}" y="{bottom - 4}" text-anchor="end">{label}</text>')
        values = trace[signal][first : last + 1]
        if show is None:
            levels = [top if value else bottom for value in values]
            path = "".join(f"V{y}h{cell}" for y in levels)
            parts.append(
                f'<path d="M{LABEL} {levels[0]}{path}" fill="none" stroke="#1f4e79" stroke-width="1.5"/>'
            )
            continue
        if valid == "msb":  # a group_t: valid, last, and two bits of group
            flags = [value >> 3 & 1 for value in values]
        elif valid:
            flags = trace[valid][first : last + 1]
        else:
            flags = [1] * count
        k = 0
        while k < count:
            same = k + 1
            # A value that counts in one cycle is a box of its own, though the next be the same.
            while same < count and not (valid and flags[same]) and flags[same] == flags[k]:
                if flags[k] and values[same] != values[k]:
                    break
                same += 1
            x, wide = LABEL + cell * k, cell * (same - k)
            if flags[k]:
                text, most = show(values[k]), int(1.4 * wide / 9)
                if len(text) > most:  # smaller than 9 it could not be read
                    text = f"{text[: most - 1]}…"
                size = min(11, 1.4 * wide / len(text))
                parts.append(
                    f'<rect x="{x + 1}" y="{top}" width="{wide - 2}" height="16" rx="3" '
                    'fill="#dbe9f6" stroke="#1f4e79"/>'
                    f'<text x="{x + wide / 2}" y="{bottom - 4}" text-anchor="middle" '
                    f'font-size="{size:.1f}">{text}</text>'
                )
            else:
                parts.append(f'<path d="M{x} {bottom - 8}h{wide}" stroke="#999"/>')
            k = same
    return "\n".join([*parts, "</svg>", ""])


def main() -> None:
    """Run, and draw both pictures."""
    rows = STEP_ROWS + AXI_ROWS
    wanted = {row[1] for row in rows} | {row[2] for row in rows if row[2] not in (None, "", "msb")}
    with tempfile.TemporaryDirectory() as folder:
        vcd = Path(folder) / "step.vcd"
        run(vcd)
        trace = cycles(vcd, wanted)
    rings = [k for k, value in enumerate(trace[BACKBONE + "ring"]) if value]
    ends = [k for k, value in enumerate(trace["s_axi_rlast"]) if value and trace["s_axi_rvalid"][k]]
    irq = next(k for k in range(rings[1] + 2, len(trace["irq_o"])) if trace["irq_o"][k])
    begin = max(k for k in range(rings[1]) if trace["s_axi_awvalid"][k] and not trace["s_axi_awvalid"][k - 1])
    (IMAGES / "timing_step.svg").write_text(draw(STEP_ROWS, trace, rings[1] - 1, irq + 1, 28))
    (IMAGES / "timing_axi.svg").write_text(draw(AXI_ROWS, trace, begin, max(ends), 38))


if __name__ == "__main__":
    main()
