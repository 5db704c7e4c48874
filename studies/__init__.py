"""Studies behind numbers in the documentation; run as `python -m studies.MODULE`."""
