"""The hardware design and its tools: sources, bit packing, synthesis, boards.

May import ``batch``, ``memory_map`` and what is below them.
"""
