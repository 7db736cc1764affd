"""Parts of the benchmark of families and of identification."""
