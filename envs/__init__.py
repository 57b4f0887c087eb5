"""The environments, a folder each: ``spec.py``, ``step.py``, ``README.md``, the core in SystemVerilog."""
