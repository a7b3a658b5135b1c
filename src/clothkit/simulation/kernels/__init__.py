"""Warp kernels: one source for the CPU (one thread advances a world) and CUDA (one block advances a world)."""
