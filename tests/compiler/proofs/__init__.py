"""Proofs, by Yosys and z3, that a generated core does what the golden functions say.

``texts`` proves the SystemVerilog equal to the graph that it was written from, ``passes`` each pass of the
compiler's equal to what it was given, and both for all words. What ``trace`` makes of golden functions is
the ground that they stand on.
"""
