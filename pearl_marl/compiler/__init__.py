"""From golden functions to compiled kernels for the CPU and the GPU."""
