"""The SystemVerilog backbone that every environment shares, as package data."""
