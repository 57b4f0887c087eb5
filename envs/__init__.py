"""The environments, a folder each: ``spec.py``, ``step.py``, ``README.md``.

They may import ``spec``, ``golden``, ``fixed_point`` and ``errors``.
"""
