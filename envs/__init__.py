"""The environments: one folder each, with ``spec.py``, ``step.py``, ``README.md`` and the core in SystemVerilog."""
