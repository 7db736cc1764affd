import neuroanimator.jax_settings  # noqa: F401 (before anything is computed)
