"""Elevators: cars fetch passengers who appear by chance, and take them up or down."""
