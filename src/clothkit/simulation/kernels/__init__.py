"""Warp kernels, from one source: on the CPU one thread advances a world, on CUDA one block of threads does."""
