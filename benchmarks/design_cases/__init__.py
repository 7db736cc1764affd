"""Parts of the benchmark of designs."""
