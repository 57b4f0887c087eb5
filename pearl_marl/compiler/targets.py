"""What hardware a core is made for: how long its operations take, and how wide its multipliers are.

Times are those of the slowest speed grade, with a share for routing, in ns. They are rough: they decide where
stages are cut, and placement has the last word.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.nodes import Node


@dataclass(frozen=True, slots=True)
class FpgaFamily:
    """The operations of a family of FPGAs."""

    register: float
    """From a register's clock to its output, and the set-up time of the next."""
    level: float
    """A table of four inputs, and the way to it."""
    carry: float
    """A bit of a carry chain."""
    chain: float
    """To enter and leave one."""
    multiplier: tuple[int, int]
    """Bits of a multiplier's two words, without signs."""
    product: float
    """A multiplication."""
    travel: int = 0
    """Stages that a word takes to a multiplier, and its product from there."""
    accumulator: int = 0
    """Bits of the adder behind a multiplier, whose registers are the multiplier's own; 0 if there is none."""
    accumulation: float = 0.0
    """An addition there."""
    small: int = 4
    """Bits that a sum or comparison is of at most if it is better a table than a carry chain."""
    compared: int = 0
    """Bits of a word that a place of a carry chain compares with a constant; 0 if no more than one."""
    shift_register: int = 0
    """Registers that are worth a bit of a shift register of any length; 0 if tools make none."""

    @property
    def fastest(self) -> float:
        """The fastest clock, in MHz: one operation in a cycle."""
        return 1000 // (self.register + 1.5 * self.level)


FAMILIES = {
    "ecp5": FpgaFamily(
        register=1.0, level=1.0, carry=0.045, chain=0.9, multiplier=(17, 17), product=5.5, travel=1, small=5
    ),
    "xc7": FpgaFamily(
        register=0.9,
        level=0.8,
        carry=0.03,
        chain=0.9,
        multiplier=(24, 17),
        product=3.2,
        accumulator=48,
        accumulation=2.3,
        compared=6,
        shift_register=4,
    ),
    "gowin": FpgaFamily(register=1.0, level=1.1, carry=0.05, chain=1.0, multiplier=(17, 17), product=5.5),
}


@dataclass(frozen=True, slots=True)
class Target:
    """A family, by its name, at a clock.

    Raises
    ------
    ArgumentError
        There is no such family, or it cannot do even one operation in a cycle of that clock.
    """

    name: str
    mhz: float

    def __post_init__(self) -> None:
        if self.name not in FAMILIES:
            raise ArgumentError(f"there is no family {self.name!r}; possible are {', '.join(FAMILIES)}")
        if not 1 <= self.mhz <= self.family.fastest:
            raise ArgumentError(
                f"the clock is {self.mhz:g} MHz; for {self.name} it can be 1 to {self.family.fastest:g} MHz"
            )

    @property
    def family(self) -> FpgaFamily:
        """What its operations take."""
        return FAMILIES[self.name]

    @property
    def budget(self) -> float:
        """What a stage's operations may take together."""
        return 1000 / self.mhz - self.family.register

    def addition(self, terms: int, bits: int) -> float:
        """Return how long a sum of words takes: a tree that leaves two, and a carry chain."""
        tree = math.ceil(math.log(terms / 2) / math.log(1.5)) * 0.9 * self.family.level if terms > 2 else 0.0
        if bits <= 3:
            return tree + 0.45 * bits * self.family.level
        return tree + self.family.chain + self.family.carry * bits

    def fan_out(self, bits: int) -> float:
        """Return how much longer it takes a flag to get where it decides on so many bits."""
        return 0.3 * self.family.level * math.log2(bits / 4) if bits > 4 else 0.0

    def accumulates(self, node: Node, bits: int) -> bool:
        """Return whether a multiplier's own adder does a sum: that of a product and another word."""
        constant, weights = node.imm if node.op == "sum" else (0, ())
        return (
            len(weights) + (constant != 0) == 2
            and all(weight == (1, 0) for weight in weights)
            and "mul" in {a.op for a in node.args}
            and bits <= self.family.accumulator
        )

    def is_small(self, node: Node, bits: int) -> bool:
        """Return whether a sum or comparison is so small that a table is better than a carry chain."""
        inputs = sum(a.bits for a in set(node.args) if a.op != "constant")
        return inputs <= self.family.small and bits <= 6 and (node.op == "less" or bits > 1)

    def delay(self, node: Node, bits: int) -> float:
        """Return how long an operation takes whose result has so many bits."""
        level = self.family.level
        match node.op:
            case "input":
                return level
            case "mul":
                return min(self.family.product, self.budget)
            case "and" | "or":
                return 0.5 * level
            case "xor":
                return 0.55 * level
            case "choose":
                return 0.75 * level
            case "equal":
                wide = max(a.bits for a in node.args)
                return level * max(0.6, math.log(wide if node.args[1].op == "constant" else 2 * wide, 4))
            case "less" | "sum" if self.is_small(node, bits):
                return 1.1 * level
            case "less":
                wide = max(a.bits for a in node.args)
                if wide <= 5:
                    return level * math.log(wide if "constant" in {a.op for a in node.args} else 2 * wide, 4)
                return self.family.chain + self.family.carry * wide
            case "sum" if self.accumulates(node, bits):
                own = 0.5 if node.imm[0] else 1.0  # a constant does not have to come from elsewhere
                return min(own * self.family.accumulation, self.budget)
            case "sum":
                constant, weights = node.imm
                terms = sum(a.bits > 1 for a in node.args)
                terms += constant != 0 and terms > 1
                return self.addition(terms, bits - min(shift for _, shift in weights))
            case "left_by" | "right_by":
                return 0.8 * level * node.args[1].bits
            case "table":
                return level * max(1, math.log(len(node.imm), 6))
        return 0.0
