"""The cases of `benchmarks/classic.py`: each measures one open line of the seminar of 1999."""
