"""From golden functions to compiled kernels for the CPU and the GPU.

May import ``batch`` and what is below it.
"""
