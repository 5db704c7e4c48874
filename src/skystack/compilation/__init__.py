"""Compilation of JAX programs: sharing, cache on disk, loops, subroutines, cores, forks."""
