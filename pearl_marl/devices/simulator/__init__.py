"""The hardware under Verilator: built once and kept, and stepped through one call in C++."""
