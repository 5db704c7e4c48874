"""Compiling JAX programs: sharing, cache on disk, loops, subroutines, random bits, cores, forks."""
