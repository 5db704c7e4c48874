"""How JAX's programs are compiled: cache, subroutines, cores, forked processes."""
