"""The environments, a folder each: ``spec.py``, ``step.py``, ``README.md``, the core in SystemVerilog.

They may import ``spec``, ``golden``, ``fixed_point`` and ``errors``.
"""
