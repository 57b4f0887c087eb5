"""The hardware design and its tools: sources, bit packing, synthesis, boards."""
