"""Compilation of JAX programs: cache, subroutines, cores, forked processes."""
